"""Behavior trees as text and graphs, and failure messages of their nodes."""

from __future__ import annotations

from py_trees import display
from py_trees.behaviour import Behaviour
from py_trees.common import Status


def drawn(root: Behaviour, status: bool = True) -> str:
    """Return a behavior tree as text, with each node's status and feedback message."""
    return display.ascii_tree(root, show_status=status).rstrip("\n")


def as_dot(root: Behaviour) -> str:
    """Return a behavior tree as a graph in Graphviz format (`dot -Tsvg`)."""
    return display.dot_tree(root).to_string()


def reasons(root: Behaviour) -> list[str]:
    """Return the feedback messages of the leaves that failed in the last run."""
    return [
        f"{node.name}: {node.feedback_message}"
        for node in root.iterate()
        if not node.children and node.feedback_message and _failed(node)
    ]


def _failed(node: Behaviour) -> bool:
    outcome = getattr(node, "outcome", None)  # composites with memory reset the status of finished children
    return node.status is Status.FAILURE if outcome is None else not outcome.ok

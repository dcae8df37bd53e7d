"""A tree as text and as a graph, and what its nodes say."""

from __future__ import annotations

from py_trees import display
from py_trees.behaviour import Behaviour
from py_trees.common import Status


def drawn(root: Behaviour, status: bool = True) -> str:
    """The tree as text, with each node's status and feedback message."""
    return display.ascii_tree(root, show_status=status).rstrip("\n")


def as_dot(root: Behaviour) -> str:
    """The tree as a graph for Graphviz (`dot -Tsvg`)."""
    return display.dot_tree(root).to_string()


def reasons(root: Behaviour) -> list[str]:
    """Why it failed: the leaves that did when they ended last, each with what it said."""
    return [
        f"{node.name}: {node.feedback_message}"
        for node in root.iterate()
        if not node.children and node.feedback_message and _failed(node)
    ]


def _failed(node: Behaviour) -> bool:
    outcome = getattr(node, "outcome", None)  # composites with memory forget the status of what they are past
    return node.status is Status.FAILURE if outcome is None else not outcome.ok

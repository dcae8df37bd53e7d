"""Recipes and stages as nodes of py_trees behavior trees, for custom recovery logic.

Requires the extra `trees` (pip install 'armcell[trees]').
"""

from armcell.core import MissingExtraError

try:
    import py_trees  # noqa: F401
except ImportError:
    raise MissingExtraError("py_trees", "trees") from None

from armcell.tasks.trees.nodes import (
    Act,
    Check,
    as_dot,
    drawn,
    held_node,
    looking,
    moving_to,
    performing,
    picking,
    placing,
    reasons,
    rests_on,
    run,
    transferring,
)

__all__ = [
    "Act",
    "Check",
    "as_dot",
    "drawn",
    "held_node",
    "looking",
    "moving_to",
    "performing",
    "picking",
    "placing",
    "reasons",
    "rests_on",
    "run",
    "transferring",
]

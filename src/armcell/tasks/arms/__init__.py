"""Tasks of two arms: side by side at their own pace, or on one object."""

from armcell.tasks.arms.context import ArmContext
from armcell.tasks.arms.side_by_side import SideBySide, side_by_side

__all__ = ["ArmContext", "SideBySide", "side_by_side"]

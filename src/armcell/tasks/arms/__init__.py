"""Tasks for arms that work side by side at their own pace, and for two arms on one object."""

from armcell.tasks.arms.carry import TwoArmCarry, moved_object_pose
from armcell.tasks.arms.coupled import move_together
from armcell.tasks.arms.hand_over import hand_over
from armcell.tasks.arms.hand_pair import CarrySettings
from armcell.tasks.arms.motion_coordinator import ArmContext
from armcell.tasks.arms.object_order import CycleTimes, orders
from armcell.tasks.arms.screw import ScrewSettings, screw
from armcell.tasks.arms.side_by_side import SideBySide, side_by_side

__all__ = [
    "ArmContext",
    "CarrySettings",
    "CycleTimes",
    "ScrewSettings",
    "SideBySide",
    "TwoArmCarry",
    "hand_over",
    "move_together",
    "moved_object_pose",
    "orders",
    "screw",
    "side_by_side",
]

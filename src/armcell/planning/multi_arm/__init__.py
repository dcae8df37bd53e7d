"""Planning for several arms: synchronized, around moving arms, carrying one object with two arms."""

from armcell.planning.multi_arm.around_moving_arm import RunningMotion, plan_around_moving_arms
from armcell.planning.multi_arm.carry import plan_carry
from armcell.planning.multi_arm.closed_chain import CarriedObject
from armcell.planning.multi_arm.synchronized import SynchronizedPlan, plan_synchronized

__all__ = [
    "CarriedObject",
    "RunningMotion",
    "SynchronizedPlan",
    "plan_around_moving_arms",
    "plan_carry",
    "plan_synchronized",
]

"""Two arms at once: together on one clock, or one beside the other's running motion."""

from armcell.planning.arms.beside import RunningMotion, plan_beside
from armcell.planning.arms.together import PairPlan, plan_together

__all__ = ["PairPlan", "RunningMotion", "plan_beside", "plan_together"]

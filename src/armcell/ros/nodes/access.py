"""What move_group needs of a cell, whether it runs in this process or behind a wire."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Protocol

from armcell.control import ExecutionSettings
from armcell.model import Gripper, RobotModel
from armcell.ros.nodes.conductor import Work
from armcell.scene import PlanningScene


class CellAccess(Protocol):
    """A cell that can be looked at, edited and moved, from any thread."""

    @property
    def model(self) -> RobotModel: ...

    def scene(self) -> PlanningScene:
        """As measured now, with what clients have put into it and what the grippers hold."""
        ...

    def change(self, make: Callable[[PlanningScene], PlanningScene]) -> PlanningScene:
        """Edit the world; gives the scene as it is then.

        Raises:
            InputError: what `make` raises; nothing was changed then.
        """
        ...

    def play(
        self,
        message: Any,
        settings: ExecutionSettings = ExecutionSettings(),
        planned_in: PlanningScene | None = None,
    ) -> Work:
        """Begin a trajectory_msgs/JointTrajectory. It ends where a change of the scene comes across its rest.

        Args:
            planned_in: the scene of its planning, with the contacts that belong to it; the present one where
                nobody knows.
        Raises:
            InputError: it cannot be played.
        """
        ...

    def drive(self, gripper: Gripper, width: float, force: float) -> Work:
        """Begin to open or close a gripper: width [m], force per finger [N]."""
        ...

    def held(self, gripper: Gripper) -> str | None:
        """The object between a gripper's fingers."""
        ...

    def works(self, joints: Iterable[str] | None = None) -> list[Work]:
        """Motions that wait or run, of some joints where they are given."""
        ...

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        """Contacts that belong to the task from now on (or no longer)."""
        ...

    def tell(self, kind: str, text: str, **data: Any) -> None:
        """Tell who observes the cell of an event, soon."""
        ...

    def stop(self) -> None:
        """End everything that moves."""
        ...

"""The interface through which move_group uses a local or remote cell."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol

from armcell.execution import ExecutionSettings
from armcell.model import Gripper, RobotModel
from armcell.ros.nodes.conductor import Work
from armcell.scene import PlanningScene


class CellAccess(Protocol):
    """Interface to observe, edit and move a cell from any thread."""

    @property
    def model(self) -> RobotModel: ...

    def scene(self) -> PlanningScene:
        """Return the measured scene with the objects that clients added and the grippers hold."""
        ...

    def change(self, make: Callable[[PlanningScene], PlanningScene]) -> PlanningScene:
        """Edit the world with the function `make` and return the resulting scene.

        Raises:
            InputError: `make` raised it; the world is unchanged.
        """
        ...

    @property
    def controllers(self) -> Mapping[str, tuple[str, ...]]:
        """Return the joint names of each controller that clients may select, by controller name."""
        ...

    def play(
        self,
        message: Any,
        settings: ExecutionSettings = ExecutionSettings(),
        planned_in: PlanningScene | None = None,
        controllers: Sequence[str] = (),
    ) -> Work:
        """Start a trajectory_msgs/JointTrajectory and return a handle to the motion.

        The motion stops if a change of the scene obstructs the rest of its path.

        Args:
            message: the JointTrajectory message.
            settings: tolerances and limits of the execution.
            planned_in: the scene in which the motion was planned, including its allowed contacts; default:
                the current scene.
            controllers: names of the only controllers that may move the joints; default: all controllers of
                the joints.
        Raises:
            InputError: the trajectory cannot be executed.
        """
        ...

    def drive(self, gripper: Gripper, width: float, force: float) -> Work:
        """Start to open or close a gripper and return a handle to the motion.

        Args:
            gripper: the gripper.
            width: target width between the fingers [m].
            force: force per finger [N].
        """
        ...

    def held(self, gripper: Gripper) -> str | None:
        """Return the name of the object between a gripper's fingers, or None."""
        ...

    def works(self, joints: Iterable[str] | None = None) -> list[Work]:
        """Return the waiting and running motions, optionally only motions of given joints."""
        ...

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        """Declare contacts of `body` with `others` as part of the task, or revoke a declaration."""
        ...

    def tell(self, kind: str, text: str, **data: Any) -> None:
        """Queue an event for the cell's observers."""
        ...

    def stop(self) -> None:
        """Stop every motion of the cell."""
        ...

"""A connected cell: its arms by name, each with pick, place and moves."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack

from armcell import _interrupts
from armcell.cell.clearing import clear_with
from armcell.cell.perceiving import Seen, look_with
from armcell.cell.seeing import CameraWatch, LiveCamera, live_cameras
from armcell.control import Driver, Follower
from armcell.core import (
    SE3,
    ArmcellError,
    ErrorCode,
    InputError,
    JointGoal,
    JointTrajectory,
    Observer,
    Outcome,
    PlanResult,
    UnknownNameError,
)
from armcell.core.pauses import no_long_pauses
from armcell.core.protocols import offers
from armcell.perception import LookSettings, MapSettings, Sight
from armcell.planning import Target, goal_of, prepare
from armcell.scene import PlanningScene
from armcell.sim import Camera, Decal
from armcell.tasks import (
    MovingSettings,
    RecoverySettings,
    SortSettings,
    StageReport,
    TaskContext,
    TaskSettings,
    grasp,
    hold,
    let_go,
    move_to,
    pick,
    pick_moving,
    place,
    release,
    sort,
    transfer,
)
from armcell.tasks.arms import (
    ArmContext,
    Carrying,
    CarrySettings,
    Pace,
    ScrewSettings,
    SideBySide,
    hand_over,
    move_together,
    orders,
    screw,
    side_by_side,
)
from armcell.tasks.clearing import ClearSettings
from armcell.tasks.sorting import Kind
from armcell.tasks.steps import Motion, perform_all


class Arm:
    """One arm of a live cell. Every method returns an `Outcome`, true when it succeeded."""

    def __init__(self, ctx: TaskContext, group: str):
        self._ctx, self.group = ctx, group

    def pick(self, item: str) -> Outcome:
        """Grasp an object and lift it."""
        model = self._ctx.scene().model
        return pick(self._ctx, item, model.gripper(arm_group=self.group))

    def place(
        self,
        item: str,
        on: str,
        at: tuple[float, float] | None = None,
        up: tuple[float, float, float] | None = None,
        lean: float | None = None,
    ) -> Outcome:
        """Put a held object on another one, `at` [m] from the middle of its surface.

        Args:
            up: direction in the object's frame that shall be up; without it, it stands as it does now.
            lean: how far it may lean on the way [rad], as a full cup.
        """
        return place(self._ctx, item, on, at, up, lean)

    def transfer(
        self,
        item: str,
        on: str,
        at: tuple[float, float] | None = None,
        up: tuple[float, float, float] | None = None,
        look: Callable[[], Outcome] | None = None,
        settings: RecoverySettings = RecoverySettings(),
    ) -> Outcome:
        """Pick an object and put it on another one, until it lies there: what is dropped is picked up again.

        Args:
            look: for objects that only cameras know, e.g. `lambda: cell.look("above")`.
        """
        gripper = self._ctx.scene().model.gripper(arm_group=self.group)
        return transfer(self._ctx, item, gripper, on, at, up, look, settings)

    def move_to(self, target: Target) -> Outcome:
        """Move to a named state, a pose of the tip (world frame), joint values, or any goal."""
        return move_to(self._ctx, self.group, goal_of(self._ctx.scene().model, self.group, target))

    def execute(self, motion: PlanResult | JointTrajectory) -> Outcome:
        """Play a planned motion of this arm: what `plan` returned, or a trajectory.

        The motion gate proves it against the world as it is now; a motion that would touch something is not
        started, and the outcome names the pair, the place and the time.

        Raises:
            InputError: there is no motion in it, or it moves joints of other arms.
        """
        planner = motion.planner_id if isinstance(motion, PlanResult) else ""
        trajectory = motion.trajectory if isinstance(motion, PlanResult) else motion
        if trajectory is None:
            raise InputError("there is no trajectory to execute", cure="execute only what was planned")
        mine = self._ctx.base.model.group(self.group).joint_names
        if other := [n for n in trajectory.joint_names if n not in mine]:
            raise InputError(f"joint {other[0]!r} is not one of {self.group!r}", cure=f"{list(mine)}")
        return perform_all(self._ctx, (Motion("execute", trajectory, planner),))

    def pick_moving(self, item: str, settings: MovingSettings = MovingSettings()) -> Outcome:
        """Grasp an object that moves at a steady speed, as on a belt, and lift it."""
        gripper = self._ctx.scene().model.gripper(arm_group=self.group)
        return pick_moving(self._ctx, item, gripper, settings)

    def grasp(self, item: str) -> Outcome:
        """Take hold of an object where it is, without lifting it."""
        return grasp(self._ctx, item, self._ctx.scene().model.gripper(arm_group=self.group))

    def let_go(self, item: str) -> Outcome:
        """Open the hand that holds an object and draw it straight back."""
        return let_go(self._ctx, item)

    def screw(
        self, item: str, turns: float, force: float = 8.0, settings: ScrewSettings = ScrewSettings()
    ) -> Outcome:
        """Turn a held object clockwise about the tool's axis, pressing with a force [N] along it."""
        return screw(self._ctx, item, turns, force, settings)

    @property
    def joints(self) -> JointGoal:
        """Where the arm is now, to come back to: `ready = arm.joints; ...; arm.move_to(ready)`."""
        names = self._ctx.scene().model.group(self.group).joint_names
        return JointGoal(self._ctx.driver.joint_state().reindexed(names))

    def open(self) -> Outcome:
        """Open the gripper fully and forget what it held."""
        return release(self._ctx, self._ctx.scene().model.gripper(arm_group=self.group))

    def hold(self, duration: float) -> Outcome:
        """Stand still [s]."""
        return hold(self._ctx, duration)

    def reserve(self, zone: str) -> AbstractContextManager[None]:
        """`with arm.reserve("bin"):` of two arms that work side by side only one is in there."""
        return self._ctx.reserve(zone)

    def choose(self, items: Sequence[str], zone: Callable[[str], str]) -> str:
        """Of what is left to do, the first whose zone the other arm is not at or going to; else the first."""
        return self._ctx.choose(items, zone)

    def meet(self, name: str) -> None:
        """Wait until the other arm's program gets to the same point."""
        self._ctx.meet(name)


class LiveCell:
    """A cell with its driver connected, inside a `with` block.

    Attributes:
        driver: the robot, simulated or real.
        scene_at_start: the planning scene before anything has moved.
        ctx: the running task: scene, reports, events.
        cameras: by name.
        seen: the objects that only cameras tell of, if there are such.
    """

    def __init__(
        self,
        name: str,
        scene: PlanningScene,
        driver: Driver,
        settings: TaskSettings,
        observers: Sequence[Observer],
        seed: int,
        cameras: Sequence[Camera] = (),
        decals: Sequence[Decal] = (),
        seen: Seen | None = None,
    ):
        self.name, self.driver, self.scene_at_start = name, driver, scene
        self.seen = seen
        self.cameras = live_cameras(cameras, driver, scene, decals)
        known = scene if seen is None else seen.taken_from(scene)
        self.ctx = TaskContext(driver, known, settings, observers, seed)
        self.model, self.seed = scene.model, seed
        self._inside = ExitStack()

    def __enter__(self) -> LiveCell:
        with ExitStack() as opening:
            for camera in self.cameras.values():
                opening.callback(camera.renderer.close)
            if not self.driver.is_simulated:  # what takes long comes before real arms wait
                for group in self.arms:
                    prepare(self.scene_at_start, group)  # compiled code to load
                opening.enter_context(no_long_pauses())
            opening.enter_context(self.driver)
            if not self.driver.is_simulated:
                opening.callback(_interrupts.last_will(self.driver.stop, urgent=True))
            self.ctx.observe()
            for group in self.arms:
                prepare(self.ctx.scene(), group)  # not on the time of the first plan
            self._inside = opening.pop_all()
        return self

    def __exit__(self, *exc: object) -> None:
        with _interrupts.deferred():
            self._inside.close()

    @property
    def arms(self) -> dict[str, Arm]:
        """Arms by planning group: those that carry a gripper, else every chain."""
        groups = [g.arm_group for g in self.model.grippers.values()]
        groups = groups or [g.name for g in self.model.groups.values() if g.tip_link]
        return {name: Arm(self.ctx, name) for name in groups}

    @property
    def arm(self) -> Arm:
        """The only arm.

        Raises:
            InputError: the cell has none or several.
        """
        arms = self.arms
        if len(arms) != 1:
            raise InputError(
                f"cell {self.name!r} has {len(arms)} arms", cure=f"use cell.arms[...]: {sorted(arms)}"
            )
        return next(iter(arms.values()))

    def __getitem__(self, group: str) -> Arm:
        if group not in self.arms:
            raise UnknownNameError("arm", group, self.arms)
        return self.arms[group]

    def side_by_side(self, **programs: Callable[[Arm], Outcome | None]) -> SideBySide:
        """Two arms at work, each at its own pace: a function per arm, which gets the `Arm`.

        Example: `cell.side_by_side(left_arm=sort_left, right_arm=sort_right)`
        """

        def program(group: str) -> Callable[[ArmContext], Outcome | None]:
            return lambda ctx: programs[group](Arm(ctx, group))

        for group in programs:
            _ = self[group]
        return side_by_side(self.ctx, {group: program(group) for group in programs})

    def orders(
        self, to: Callable[[str], str], pace: Pace = Pace(), **streams: Sequence[str]
    ) -> dict[str, list[str]]:  # fmt: skip
        """By arm, the order to bring its things in, so that both are done early and do not wait for a zone.

        Example: `cell.orders(tray_of, left_arm=left_cubes, right_arm=right_cubes)["left_arm"]`

        Args:
            to: the object that a thing goes to, which one arm at a time reserves.
        """
        for group in streams:
            _ = self[group]
        return orders(self.scene(), streams, to, self.ctx.settings, pace)

    def carry(self, item: str, settings: CarrySettings = CarrySettings(), **ends: str) -> Carrying:
        """An object for two arms: by arm, the object's subframe that it takes hold of.

        Example: `cell.carry("rod", left_arm="left_end", right_arm="right_end")`
        """
        for group in ends:
            _ = self[group]
        return Carrying(self.ctx, self._both(ends), item, ends, settings)

    def hand_over(self, item: str, to: str, at: Sequence[SE3] = ()) -> Outcome:
        """The arm that holds an object gives it to another one, in the air.

        Args:
            to: the group of the arm that takes it.
            at: poses T_world_object to meet at, the best first; by default half-way between the arms.
        """
        _ = self[to]
        return hand_over(self.ctx, item, self.model.gripper(arm_group=to), at)

    def move_together(self, **targets: Target) -> Outcome:
        """Two arms to a target each; they start and arrive together."""
        scene = self.ctx.scene()
        goals = {group: goal_of(scene.model, group, target) for group, target in targets.items()}
        return move_together(self.ctx, self._both(targets), goals)

    def _both(self, groups: Iterable[str]) -> str:
        """The group of several arms' joints.

        Raises:
            InputError: there is none.
        """
        wanted = {n for group in groups for n in self.model.group(group).joint_names}
        for group in self.model.groups.values():
            if set(group.joint_names) == wanted:
                return group.name
        raise InputError(f"no planning group has the joints of {' and '.join(groups)}")

    @property
    def reports(self) -> list[StageReport]:
        """The stages performed so far."""
        return self.ctx.reports

    def stop(self) -> None:
        """Stop the running motion, from any thread. Until `resume()` every call is PREEMPTED."""
        self.ctx.cancel.set()

    def resume(self) -> Outcome:
        """Make the cell ready to move again: after `stop()`, a protective stop, a lost link. From any thread.

        Real arms whose link was lost are connected again. Nothing moves; old goals are forgotten. Where
        nothing has stopped the cell nothing happens, also while it moves.

        Returns:
            SUCCESS: the cell is ready. Else it stays stopped: the message names the arm, what is wrong and
            what to do before the next `resume()`.
        """
        try:
            self.driver.resume()
        except ArmcellError as error:
            fault = self.driver.fault() if offers(self.driver, Follower) else None
            return Outcome(ErrorCode.CONTROL_FAILED if fault is None else fault.code, str(error))
        if (
            self.ctx.cancel.is_set()
        ):  # what runs keeps the one that was set: no resume is too early for a stop
            self.ctx.cancel = threading.Event()
        return Outcome(ErrorCode.SUCCESS)

    def scene(self) -> PlanningScene:
        """The planning scene as measured now, from any thread."""
        return self.ctx.scene()

    def change_scene(self, make: Callable[[PlanningScene], PlanningScene]) -> PlanningScene:
        """Change what planners know of the world: at any time and from any thread, also while the arm moves.

        What is planned afterwards keeps to it. A motion across whose rest something has come stops with
        MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE and names it; others go on. Physics is not changed.

        Example: `cell.change_scene(lambda scene: scene.with_object(box))`, or a diff: `diff.applied_to`

        Args:
            make: makes another scene of the present one; quickly, others wait for it.
        Returns:
            The scene as it is then.
        Raises:
            InputError: an object that is held would be gone; or what `make` raises. Nothing is changed then.
        """
        return self.ctx.change_scene(make)

    # --- cameras ---
    def camera(self, name: str | None = None) -> LiveCamera:
        """A camera by name; without one, the only one.

        Raises:
            UnknownNameError: no such camera.
            InputError: none, or several and no name.
        """
        if name is None and len(self.cameras) != 1:
            raise InputError(
                f"cell {self.name!r} has {len(self.cameras)} cameras",
                cure=f"name one: {sorted(self.cameras)}",
            )
        name = next(iter(self.cameras)) if name is None else name
        if name not in self.cameras:
            raise UnknownNameError("camera", name, self.cameras)
        return self.cameras[name]

    def look(self, camera: str | None = None, settings: LookSettings | None = None) -> Sight:
        """Look for the movable objects with a camera. Those whose poses come from cameras only are put into
        the planning scene where they are seen; an outcome without them says why.

        Args:
            settings: by default those of `perception` in the cell file.
        """
        eye = self.camera(camera)
        return look_with(eye, self.ctx, self.seen, settings)

    def clear(
        self, bin: str, into: str, table: str, camera: str, tray_camera: str,
        settings: ClearSettings = ClearSettings(),
    ) -> Outcome:  # fmt: skip
        """Take everything out of a bin, with no knowledge of what it is but two cameras', into another one.

        Args:
            table: that both stand on; what falls beside them is picked up from it.
            camera, tray_camera: look at the bin and at `into`.
        Returns:
            SUCCESS when the cameras see nothing any more and, in physics, nothing lies elsewhere than in
            `into`; the evidence has the counts.
        """
        gripper = self.model.gripper(arm_group=self.arm.group)
        eyes = self.camera(camera), self.camera(tray_camera)
        return clear_with(self.ctx, self.scene_at_start, gripper, bin, into, table, *eyes, settings)

    def sort(
        self, into: Mapping[str, str], camera: str, by: str | Kind = "colour",
        settings: SortSettings = SortSettings(),
    ) -> Outcome:  # fmt: skip
        """Put every thing that a camera sees on the object for its colour (or "shape").

        Example: `cell.sort({"red": "red_mat", "blue": "blue_mat"}, camera="above")`
        """
        gripper = self.model.gripper(arm_group=self.arm.group)
        return sort(self.ctx, gripper, lambda: self.look(camera), into, by, settings)

    def watch(
        self, camera: str | None = None, settings: MapSettings = MapSettings(), rate: float = 10.0
    ) -> CameraWatch:
        """Keep the planning scene's octomap true to what a camera sees, `rate` [Hz] times a second."""
        return CameraWatch(self.ctx, self.camera(camera), settings, rate)

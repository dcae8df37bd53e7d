"""A connected cell, `LiveCell`: its arms by name, with methods to pick, place and move."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from typing import Any

from armcell import _interrupts
from armcell.cell.bin_clearing import Destination, clear_with
from armcell.cell.live_cameras import LiveCamera, OctomapUpdater, live_cameras
from armcell.cell.perceived_objects import DetectedPoses, look_with
from armcell.collision.inter_arm_checker import combined_group
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
from armcell.core.gc_pauses import gc_frozen
from armcell.drivers import Driver
from armcell.perception import DetectionResult, LookSettings, MapSettings, Sensors3d
from armcell.planning import Target, goal_of, prepare_group
from armcell.scene import PlanningScene
from armcell.sim import Camera, Decal
from armcell.tasks import (
    ConveyorPickSettings,
    RecoverySettings,
    SortSettings,
    StageReport,
    TaskContext,
    TaskSettings,
    grasp,
    hold,
    move_to,
    pick,
    pick_moving,
    place,
    release,
    release_and_retreat,
    sort,
    transfer,
)
from armcell.tasks.arms import (
    ArmContext,
    CarrySettings,
    CycleTimes,
    ScrewSettings,
    SideBySide,
    TwoArmCarry,
    hand_over,
    move_together,
    orders,
    screw,
    side_by_side,
)
from armcell.tasks.bin_clearing import BinClearingSettings
from armcell.tasks.sorting import Kind
from armcell.tasks.steps import Motion, perform_all


class Arm:
    """One arm of a live cell, with methods for commanding it.

    Each command returns an `Outcome`, which is true if the command succeeded.
    """

    def __init__(self, ctx: TaskContext, group: str):
        self._ctx, self.group = ctx, group

    def pick(self, item: str) -> Outcome:
        """Grasp an object with an arm of the live cell and lift it."""
        model = self._ctx.scene().model
        return pick(self._ctx, item, model.gripper(arm_group=self.group))

    def place(
        self,
        item: str,
        on: str,
        at: tuple[float, float] | None = None,
        up: tuple[float, float, float] | None = None,
        lean: float | None = None,
        pose: SE3 | None = None,
    ) -> Outcome:
        """Place a held object on another object with an arm of the live cell.

        Args:
            on: the object that supports the placed object.
            at: target position [m] on the support surface, from its center.
            up: direction in the object's frame that must point up; default: the object's current orientation.
            lean: largest tilt of the object during the motion [rad], e.g. for a full cup.
            pose: T_world_object at which the object rests on the other one; excludes `at` and `up`.
        """
        return place(self._ctx, item, on, at, up, lean, pose)

    def transfer(
        self,
        item: str,
        on: str,
        at: tuple[float, float] | None = None,
        up: tuple[float, float, float] | None = None,
        look: Callable[[], Outcome] | None = None,
        settings: RecoverySettings = RecoverySettings(),
    ) -> Outcome:
        """Transfer an object onto another one with an arm of the live cell, and recover from failures such as
        a dropped object.

        Args:
            on: the object that supports the placed object.
            at: target position [m] on the support surface, from its center.
            up: direction in the object's frame that must point up; default: the object's current orientation.
            look: finds the object again if only cameras measure its pose, e.g. `lambda: cell.look("above")`.
        """
        gripper = self._ctx.scene().model.gripper(arm_group=self.group)
        return transfer(self._ctx, item, gripper, on, at, up, look, settings)

    def move_to(self, target: Target) -> Outcome:
        """Move an arm of the live cell to a named state, a tip pose in the world frame, joint values or
        another goal.
        """
        return move_to(self._ctx, self.group, goal_of(self._ctx.scene().model, self.group, target))

    def execute(self, motion: PlanResult | JointTrajectory) -> Outcome:
        """Execute a planned motion, given as a `PlanResult` or a trajectory, with an arm of the live cell.

        The motion gate checks the motion against the current scene. If the motion would collide, the gate
        does not start it, and the outcome names the colliding pair, the place and the time.

        Raises:
            InputError: the result contains no trajectory, or the trajectory moves joints of other arms.
        """
        planner = motion.planner_id if isinstance(motion, PlanResult) else ""
        trajectory = motion.trajectory if isinstance(motion, PlanResult) else motion
        if trajectory is None:
            raise InputError("there is no trajectory to execute", hint="execute only what was planned")
        mine = self._ctx.base.model.group(self.group).joint_names
        if other := [n for n in trajectory.joint_names if n not in mine]:
            raise InputError(f"joint {other[0]!r} is not one of {self.group!r}", hint=f"{list(mine)}")
        return perform_all(self._ctx, (Motion("execute", trajectory, planner),))

    def pick_moving(self, item: str, settings: ConveyorPickSettings = ConveyorPickSettings()) -> Outcome:
        """Let an arm of the live cell pick an object that moves at constant speed, such as on a conveyor."""
        gripper = self._ctx.scene().model.gripper(arm_group=self.group)
        return pick_moving(self._ctx, item, gripper, settings)

    def grasp(self, item: str) -> Outcome:
        """Grasp an object at its present pose with an arm of the live cell, without lifting it."""
        return grasp(self._ctx, item, self._ctx.scene().model.gripper(arm_group=self.group))

    def let_go(self, item: str) -> Outcome:
        """Open the gripper of an arm that holds an object, and retreat in a straight line."""
        return release_and_retreat(self._ctx, item)

    def screw(
        self, item: str, turns: float, force: float = 8.0, settings: ScrewSettings = ScrewSettings()
    ) -> Outcome:
        """Screw in a held object with an arm of the live cell: turn it clockwise about the tool axis while
        pressing with `force` [N].
        """
        return screw(self._ctx, item, turns, force, settings)

    @property
    def joints(self) -> JointGoal:
        """Return the measured joint positions of an arm in a live cell. `move_to` accepts them as a goal.

        Example: `ready = arm.joints; ...; arm.move_to(ready)`
        """
        names = self._ctx.scene().model.group(self.group).joint_names
        return JointGoal(self._ctx.driver.joint_state().reindexed(names))

    def open(self) -> Outcome:
        """Open the gripper of a live cell's arm fully and release the object that it holds, if any."""
        return release(self._ctx, self._ctx.scene().model.gripper(arm_group=self.group))

    def hold(self, duration: float) -> Outcome:
        """Keep a live cell's arm still for `duration` [s]."""
        return hold(self._ctx, duration)

    def reserve(self, zone: str) -> AbstractContextManager[None]:
        """Reserve a zone for an arm of the live cell: `with arm.reserve("bin"):` keeps other arms out."""
        return self._ctx.reserve(zone)

    def choose(self, items: Sequence[str], zone: Callable[[str], str]) -> str:
        """Return the first of `items`, for example objects to pick, whose zone is free. A zone is free if no
        other arm of the live cell occupies or approaches the zone.

        If other arms occupy or approach all zones, return the first item.
        """
        return self._ctx.choose(items, zone)

    def rendezvous(self, name: str) -> None:
        """Pause the program of one arm in a live cell until all other arms reach the same rendezvous."""
        self._ctx.rendezvous(name)


class LiveCell:
    """A live cell: a cell with a connected driver, for use in a `with` block.

    Attributes:
        driver: the driver of the robot, simulated or real.
        scene_at_start: the planning scene before the first motion.
        ctx: the running task: scene, reports, events.
        cameras: the cameras by name.
        seen: the objects whose poses only cameras measure; None if there are none.
        sensors: sensors whose point clouds and depth images build the octomap; None if there are none.
        planner_configs: content of an ompl_planning.yaml for the requests of MoveIt clients, or empty.
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
        seen: DetectedPoses | None = None,
    ):
        self.name, self.driver, self.scene_at_start = name, driver, scene
        self.seen = seen
        self.sensors: Sensors3d | None = None
        self.planner_configs: Mapping[str, Any] = {}
        self.cameras = live_cameras(cameras, driver, scene, decals)
        known = scene if seen is None else seen.taken_from(scene)
        self.ctx = TaskContext(driver, known, settings, observers, seed)
        self.model, self.seed = scene.model, seed
        self._inside = ExitStack()

    def __enter__(self) -> LiveCell:
        with ExitStack() as opening:
            for camera in self.cameras.values():
                opening.callback(camera.renderer.close)
            if not self.driver.is_simulated:  # slow preparations run before real arms connect
                for group in self.arms:
                    prepare_group(self.scene_at_start, group)  # loads compiled code
                opening.enter_context(gc_frozen())
            opening.enter_context(self.driver)
            if not self.driver.is_simulated:
                opening.callback(_interrupts.last_will(self.driver.stop, urgent=True))
            self.ctx.observe()
            if self.driver.is_simulated:
                for group in self.arms:
                    prepare_group(self.ctx.scene(), group)  # so that the first plan is fast
            self._inside = opening.pop_all()
        return self

    def __exit__(self, *exc: object) -> None:
        with _interrupts.deferred():
            self._inside.close()

    def release(self) -> None:
        """Free the memory of a live cell's simulation. Call this method after the `with` block.

        The call is optional. Afterwards, the state of this cell cannot be read.
        """
        if self.driver.world is not None:
            self.driver.world.close()

    @property
    def arms(self) -> dict[str, Arm]:
        """Return a live cell's arms by planning group: all arms with a gripper or,
        if there are none, all kinematic chains.
        """
        return {name: Arm(self.ctx, name) for name in self.model.arm_groups}

    @property
    def arm(self) -> Arm:
        """Return the arm of a live cell that has only one arm.

        Raises:
            InputError: the cell has no arm or several arms.
        """
        arms = self.arms
        if len(arms) != 1:
            raise InputError(
                f"cell {self.name!r} has {len(arms)} arms", hint=f"use cell.arms[...]: {sorted(arms)}"
            )
        return next(iter(arms.values()))

    def __getitem__(self, group: str) -> Arm:
        if group not in self.arms:
            raise UnknownNameError("arm", group, self.arms)
        return self.arms[group]

    def side_by_side(self, **programs: Callable[[Arm], Outcome | None]) -> SideBySide:
        """Run one program per arm of a live cell.
        Each program is a function that takes an `Arm` and proceeds at its own pace.

        Example: `cell.side_by_side(left_arm=sort_left, right_arm=sort_right)`
        """

        def program(group: str) -> Callable[[ArmContext], Outcome | None]:
            return lambda ctx: programs[group](Arm(ctx, group))

        for group in programs:
            _ = self[group]
        return side_by_side(self.ctx, {group: program(group) for group in programs})

    def orders(
        self, to: Callable[[str], str], cycle_times: CycleTimes = CycleTimes(), **streams: Sequence[str]
    ) -> dict[str, list[str]]:  # fmt: skip
        """Return the order in which each arm of a live cell should
        handle its objects so that all arms finish early.

        With these orders, the arms rarely wait for each other at a zone.

        Example: `cell.orders(tray_of, left_arm=left_cubes, right_arm=right_cubes)["left_arm"]`

        Args:
            to: the destination of an object: a zone that only one arm at a time may reserve.
            streams: the objects of each arm, by planning group.
        """
        for group in streams:
            _ = self[group]
        return orders(self.scene(), streams, to, self.ctx.settings, cycle_times)

    def carry(self, item: str, settings: CarrySettings = CarrySettings(), **ends: str) -> TwoArmCarry:
        """Return the `TwoArmCarry` task of a live cell, in which two arms carry one object together.

        Example: `cell.carry("rod", left_arm="left_end", right_arm="right_end")`

        Args:
            ends: for each arm, the subframe of the object that the arm grasps.
        """
        for group in ends:
            _ = self[group]
        return TwoArmCarry(self.ctx, combined_group(self.model, ends), item, ends, settings)

    def hand_over(self, item: str, to: str, at: Sequence[SE3] = ()) -> Outcome:
        """Hand an object over in the air between two arms of a live cell.

        Args:
            to: the planning group of the receiving arm.
            at: candidate poses T_world_object, best first; default: half-way between the arms' bases.
        """
        _ = self[to]
        return hand_over(self.ctx, item, self.model.gripper(arm_group=to), at)

    def move_together(self, **targets: Target) -> Outcome:
        """Move several arms of a live cell, each to its own target.
        All of them start at the same time and arrive at the same time.
        """
        scene = self.ctx.scene()
        goals = {group: goal_of(scene.model, group, target) for group, target in targets.items()}
        return move_together(self.ctx, combined_group(self.model, targets), goals)

    @property
    def reports(self) -> list[StageReport]:
        """Return the reports of all task stages that a live cell has performed so far."""
        return self.ctx.reports

    def stop(self) -> None:
        """Stop all motions of a live cell. Until `resume()` is called, every call returns PREEMPTED.

        Any thread may call this method.
        """
        self.ctx.cancel.set()

    def resume(self) -> Outcome:
        """Prepare a live cell for further motions after `stop()`, a fault or a lost connection.

        Call it from any thread. It reconnects real arms whose connection was lost. It starts no motion and
        discards old goals. If the cell is not stopped, it does nothing, also during a motion.

        Returns:
            SUCCESS if the cell is ready. Otherwise the cell stays stopped, and the message names the arm, the
            cause and the remedy to apply before the next `resume()`.
        """
        try:
            self.driver.resume()
        except ArmcellError as error:
            fault = self.driver.fault()
            return Outcome(ErrorCode.CONTROL_FAILED if fault is None else fault.code, str(error))
        if (
            self.ctx.cancel.is_set()
        ):  # a running motion keeps the event that is set, so an early resume cannot undo the stop
            self.ctx.cancel = threading.Event()
        return Outcome(ErrorCode.SUCCESS)

    def scene(self) -> PlanningScene:
        """Return a live cell's scene with the measured state. This method is thread-safe."""
        return self.ctx.scene()

    def change_scene(self, make: Callable[[PlanningScene], PlanningScene]) -> PlanningScene:
        """Change the planning scene of a live cell.
        This method is thread-safe and can be called even during a motion.

        Later plans use the changed scene. If the change blocks the rest of a running motion, the motion stops
        with MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE and names the obstacle; other motions continue.
        Physics does not change.

        Example: `cell.change_scene(lambda scene: scene.with_object(box))`, or a diff: `diff.applied_to`

        Args:
            make: returns the changed scene for the current one. It must be fast: other threads wait for it.
        Returns:
            The changed scene.
        Raises:
            InputError: the change removes a held object. Errors that `make` raises pass through. In both
                cases, the scene stays unchanged.
        """
        return self.ctx.change_scene(make)

    # --- cameras ---
    def camera(self, name: str | None = None) -> LiveCamera:
        """Return the camera of a live cell that has the given name.
        A cell with a single camera needs no name.

        Raises:
            UnknownNameError: no camera has this name.
            InputError: no name was given, and the cell has no camera or several cameras.
        """
        if name is None and len(self.cameras) != 1:
            raise InputError(
                f"cell {self.name!r} has {len(self.cameras)} cameras",
                hint=f"name one: {sorted(self.cameras)}",
            )
        name = next(iter(self.cameras)) if name is None else name
        if name not in self.cameras:
            raise UnknownNameError("camera", name, self.cameras)
        return self.cameras[name]

    def look(
        self, camera: str | Sequence[str] | None = None, settings: LookSettings | None = None
    ) -> DetectionResult:
        """Detect the movable objects with cameras of the live cell and update the planning scene.

        Objects whose poses come only from cameras are set to their detected poses. If an object is not found,
        or its pose is ambiguous, the outcome states the reason, and the object is not in the scene.

        Args:
            camera: one camera, or several that look at the same objects from different sides.
            settings: default: the `perception` settings of the cell file.
        """
        names = (camera,) if camera is None or isinstance(camera, str) else camera
        return look_with([self.camera(name) for name in names], self.ctx, self.seen, settings)

    def clear(
        self, bin: str, into: str | Mapping[str, str], table: str, camera: str,
        tray_camera: str | Mapping[str, str], settings: BinClearingSettings = BinClearingSettings(),
    ) -> Outcome:  # fmt: skip
        """Clear a bin in a live cell: move all objects into another container. The poses of the objects come
        only from cameras, one per container.

        Example for two arms: `cell.clear("bin", into={"left_arm": "left_tray", "right_arm": "right_tray"},
        ...)`. The arms work side by side; each puts its objects into its own container.

        Args:
            into: the container for the objects; for several arms, the container of each, by planning group.
            table: the object that supports the containers; fallen objects are picked up from it.
            camera: the camera that looks at the bin.
            tray_camera: the camera that looks at `into`; for several arms, a camera by planning group.
        Returns:
            SUCCESS if the cameras see no object outside `into` and, in physics, all objects are in `into`;
            the evidence has the counts.
        Raises:
            InputError: `into` and `tray_camera` name different arms.
        """
        trays = {self.arm.group: into} if isinstance(into, str) else into
        eyes = dict.fromkeys(trays, tray_camera) if isinstance(tray_camera, str) else tray_camera
        if eyes.keys() != trays.keys():
            raise InputError(
                f"the containers are for {sorted(trays)}, the cameras for {sorted(eyes)}",
                hint="name one container and one camera for each arm",
            )
        destinations = [
            Destination(self.model.gripper(arm_group=self[group].group), tray, self.camera(eyes[group]))
            for group, tray in trays.items()
        ]
        eye = self.camera(camera)
        return clear_with(self.ctx, self.scene_at_start, bin, table, eye, destinations, settings)

    def sort(
        self, into: Mapping[str, str], camera: str, by: str | Kind = "color",
        settings: SortSettings = SortSettings(),
    ) -> Outcome:  # fmt: skip
        """Sort the objects that a camera of the live cell sees: place each object on the target for its color
        or shape.

        Example: `cell.sort({"red": "red_mat", "blue": "blue_mat"}, camera="above")`
        """
        gripper = self.model.gripper(arm_group=self.arm.group)
        return sort(self.ctx, gripper, lambda: self.look(camera), into, by, settings)

    def watch(
        self, camera: str | None = None, settings: MapSettings = MapSettings(), rate: float = 10.0
    ) -> OctomapUpdater:
        """Keep the octomap of a live cell up to date with images from a camera, at `rate` [Hz]."""
        return OctomapUpdater(self.ctx, self.camera(camera), settings, rate)

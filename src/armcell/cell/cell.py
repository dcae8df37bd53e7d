"""`Cell`, a loaded cell: robot with calibration, objects, task, settings and disturbances.

`Cell.connect` returns a `LiveCell`. The block `disturbances` of the cell file is converted to SI units.
`real: {calibration: apply}` applies the robots' factory calibration to the cell's model.
"""

from __future__ import annotations

import os
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from armcell.cell.cameras import camera_of, decal_of
from armcell.cell.controllers import controllers_of
from armcell.cell.dropped_objects import drop_objects
from armcell.cell.live import LiveCell
from armcell.cell.objects_file import object_of, screwed
from armcell.cell.perceived_objects import DetectedPoses, PerceivingDriver
from armcell.cell.schema import CameraSpec, CellSpec, MarkerSpec
from armcell.cell.twin import twin_guard
from armcell.core import SE3, SO3, InputError, Observer, UnknownNameError
from armcell.core.checks import settings_from
from armcell.drivers import DriverOptions, drivers
from armcell.drivers.disturbed_sim import Displacement, Disturbances, DisturbedSim, Push
from armcell.drivers.real import RealSettings, RobotIdentity, identify_all, kind_of, real_settings
from armcell.model import MountedRobot, RobotModel, compose, load_ompl_planning, load_robot
from armcell.model.loader import xacro_texts
from armcell.perception import Sensors3d, load_sensors_3d
from armcell.scene import CollisionObject, Material, PlanningScene
from armcell.sim import Camera, Decal, PhysicsSettings
from armcell.sim.gain_files import with_gains_file
from armcell.sim.joint_gains import check_joint_gains
from armcell.tasks import TaskSettings, make_stage

T = TypeVar("T")


def disturbances_of(spec: CellSpec, model: RobotModel, file: Path) -> Disturbances:
    """Return the disturbances of a cell's simulated robot, in SI units.

    Raises:
        UnknownNameError: a joint, link or object does not exist.
        InputError: a pushed object is fixed, or a moved object is screwed into another object.
    """
    given = spec.disturbances
    fingers = {name for g in model.grippers.values() for name in g.joint_names}
    turning = [n for n in model.joint_names if n not in fingers and model.joints[n].type != "prismatic"]
    for name in given.joint_offset_deg:
        if name not in turning:
            place = "disturbances/joint_offset_deg"
            raise UnknownNameError("turning joint of an arm", name, turning, file=file, element=place)
    movable = [name for name, item in spec.objects.items() if item.movable]
    for name, push in given.pushes.items():
        if push.on in model.links or push.on in movable:
            continue
        place = f"disturbances/pushes/{name}"
        if push.on in spec.objects:
            raise InputError(
                f"the object {push.on!r} is fixed", file=file, element=place, hint="give it 'movable: true'"
            )
        raise UnknownNameError("link or object", push.on, [*model.links, *movable], file=file, element=place)
    for name in given.moved:
        place = f"disturbances/moved/{name}"
        if name not in spec.objects:
            raise UnknownNameError("object", name, spec.objects, file=file, element=place)
        if (thread := spec.objects[name].thread) is not None:
            reason, hint = f"the object is screwed into {thread.into!r}", "move that, or push this"
            raise InputError(reason, file=file, element=place, hint=hint)
    return Disturbances(
        {name: float(np.deg2rad(value)) for name, value in given.joint_offset_deg.items()},
        float(np.deg2rad(given.joint_noise_deg)),
        given.latency,
        tuple(Push(push.on, push.at, push.duration, push.force) for push in given.pushes.values()),
        tuple(Displacement(n, m.at, m.by, float(np.deg2rad(m.turn_deg))) for n, m in given.moved.items()),
    )


def with_robot_calibration(scene: PlanningScene, real: dict) -> PlanningScene:
    """Return a cell's scene. It uses the calibrated kinematics of the robots if the cell file requests them.

    Raises:
        InputError: a robot does not answer, is another robot than named in the cell file, or its kinematics
            do not fit the model.
    """
    settings = real_settings(real, scene.model)
    if settings.calibration != "apply":
        return scene
    return replace(scene, model=with_geometry(scene.model, settings, identify_all(settings)))


def with_geometry(
    model: RobotModel, settings: RealSettings, found: Mapping[str, RobotIdentity]
) -> RobotModel:
    """Return a cell's robot model with the factory calibration that the controllers of real arms have
    reported. Arms without a report keep their kinematics.

    Args:
        found: the identities of the robots, by planning group.
    Raises:
        InputError: an arm is another robot than named in the cell file, or does not fit the model.
    """
    for group, identity in found.items():
        arm = settings.arms[group]
        kind_of(arm).check_identity(group, arm, identity)
        model = kind_of(arm).calibrated(model, group, identity)
    return model


class Cell:
    """A loaded, immutable cell. A seed selects one set of its randomized values."""

    def __init__(
        self,
        name: str,
        file: Path,
        spec: CellSpec,
        model: RobotModel | None = None,
        allow_env: bool | None = None,
    ):
        self.name, self.file, self.spec, self.allow_env = name, file, spec, allow_env
        self.model: RobotModel = model or self._robot()
        self.settings: TaskSettings = self._settings(TaskSettings, spec.settings, "settings")
        self.physics: PhysicsSettings = self._physics()
        self._check_names()
        self.disturbances: Disturbances = disturbances_of(spec, self.model, self.file)
        self.scene()  # report errors in the objects now
        self.sensors: Sensors3d | None = self._sensors()
        self.planner_configs: Mapping[str, Any] = self._planner_configs()
        self.cameras = tuple(self._camera(n, c) for n, c in spec.cameras.items())
        self.decals = tuple(self._decal(n, m) for n, m in spec.markers.items())
        self.controllers = controllers_of(spec.controllers, self.model, self.file)

    def _fail(self, element: str, reason: str, hint: str | None = None) -> InputError:
        return InputError(reason, file=self.file, element=element, hint=hint)

    def _robot(self) -> RobotModel:
        spec = self.spec.robot
        try:
            given = xacro_texts(self.spec.xacro_args, self.file)
            model = load_robot(spec.model, self.file.parent, self.allow_env, given)
            if spec.pose is None:
                return model
            return compose(
                model.name, [MountedRobot(model, T_parent_root=SE3.from_mapping(spec.pose, "robot/pose"))]
            )
        except InputError as error:
            raise self._fail("robot", str(error)) from None

    def _settings(self, cls: type[T], values: dict[str, Any], element: str) -> T:
        for field in fields(cls):  # type: ignore[arg-type]  # nested blocks first, so that errors name them
            if is_dataclass(field.default) and field.name in values:
                self._settings(type(field.default), values[field.name], f"{element}/{field.name}")
        try:
            return settings_from(cls, values, element)
        except InputError as error:
            raise self._fail(error.element or element, error.reason, error.hint) from None

    def _physics(self) -> PhysicsSettings:
        try:
            values = with_gains_file(self.spec.physics, self.model, self.file.parent)
        except InputError as error:
            if error.file is not None:
                raise
            raise self._fail("physics/gains", error.reason, error.hint) from None
        settings = self._settings(PhysicsSettings, values, "physics")
        check_joint_gains(settings.joint_gains, self.model, file=self.file, element="physics/joint_gains")
        return settings

    def _sensors(self) -> Sensors3d | None:
        """Return the 3D sensors of a `Cell`, from the sensors_3d.yaml that the cell file names, or else from
        the robot's MoveIt package.
        """
        file = self._moveit_file(self.spec.ros.sensors, "sensors_3d.yaml")
        return None if file is None else load_sensors_3d(file)

    def _planner_configs(self) -> Mapping[str, Any]:
        """Return the planner settings of a `Cell`, from the ompl_planning.yaml that the cell file names, or
        else from the robot's MoveIt package.
        """
        file = self._moveit_file(self.spec.ros.planners, "ompl_planning.yaml")
        return {} if file is None else load_ompl_planning(file, self.model)

    def _moveit_file(self, named: str | None, name: str) -> Path | None:
        """Return the path of a cell's MoveIt configuration file, or None if there is no such file. A file
        named in the cell file takes precedence over the one in the robot's MoveIt package.
        """
        if named is not None:
            return self.file.parent / named
        model = self.spec.robot.model
        file = self.file.parent / model / "config" / name if isinstance(model, str) else None
        return file if file is not None and os.path.isfile(file) else None

    def _camera(self, name: str, spec: CameraSpec) -> Camera:
        try:
            return camera_of(name, spec, self.model, self.scene().state.positions, self.file.parent)
        except UnknownNameError as error:
            raise UnknownNameError(
                error.kind, error.name, error.known, file=self.file, element=f"cameras/{name}"
            ) from None
        except InputError as error:
            if error.file is not None:
                raise
            raise self._fail(f"cameras/{name}", error.reason, error.hint) from None

    def _decal(self, name: str, spec: MarkerSpec) -> Decal:
        try:
            return decal_of(name, spec, [*self.model.links, *self.spec.objects])
        except InputError as error:
            raise self._fail(f"markers/{name}", error.reason, error.hint) from None

    def _check_names(self) -> None:
        """Check that the names in the blocks `randomize`, `start`, `perception`, `drop` and `task` of this
        `Cell` exist.

        Raises:
            UnknownNameError: a name does not exist.
            InputError: an object is fixed but must be movable (or vice versa), or a camera has no depth.
        """
        spec, where = self.spec, self.file
        for name in spec.randomize:
            if name not in spec.objects:
                raise UnknownNameError("object", name, spec.objects, file=where, element="randomize")
            if not spec.objects[name].movable:
                raise self._fail(f"randomize/{name}", "the object is fixed", "give it 'movable: true'")
        for group, state in spec.start.items():
            try:
                self.model.named_state(group, state)
            except UnknownNameError as error:
                raise UnknownNameError(
                    error.kind, error.name, error.known, file=where, element="start"
                ) from None
        seen = spec.perception
        if seen is not None:
            if seen.camera not in spec.cameras:
                raise UnknownNameError("camera", seen.camera, spec.cameras, file=where, element="perception")
            if not spec.cameras[seen.camera].depth:
                hint = "take 'depth: false' away, or name another camera"
                raise self._fail("perception", f"camera {seen.camera!r} has no depth", hint)
            for name in (*seen.objects, *([seen.surface] if seen.surface else [])):
                if name not in spec.objects:
                    raise UnknownNameError("object", name, spec.objects, file=where, element="perception")
            for name in seen.objects:
                if not spec.objects[name].movable:
                    raise self._fail("perception", f"object {name!r} is fixed", "give it 'movable: true'")
        if spec.drop is not None:
            for name in (*spec.drop.objects, spec.drop.into):
                if name not in spec.objects:
                    raise UnknownNameError("object", name, spec.objects, file=where, element="drop")
                if spec.objects[name].movable == (name == spec.drop.into):
                    must = "fixed" if name == spec.drop.into else "movable"
                    raise self._fail("drop", f"object {name!r} must be {must}")
        for i, step in enumerate(spec.task):
            for camera in step.cameras:
                if camera not in spec.cameras:
                    raise UnknownNameError("camera", camera, spec.cameras, file=where, element=f"task/{i}")
            names = [step.pick] if step.pick else [step.goal.object, step.goal.on] if step.goal else []
            for name in names:
                if name not in spec.objects:
                    raise UnknownNameError("object", name, spec.objects, file=where, element=f"task/{i}")
            for name, values in (step.stage or {}).items():
                try:
                    make_stage(name, values)
                except InputError as error:
                    raise self._fail(f"task/{i}", error.reason, error.hint) from None
            arms = self.model.arm_groups
            if step.arm is not None and step.arm not in arms:
                raise UnknownNameError("arm", step.arm, arms, file=where, element=f"task/{i}")
            groups = self.model.named_states if step.arm is None else (step.arm,)
            states = {s for group in groups for s in self.model.named_states.get(group, {})}
            if step.move is not None and step.move not in states:
                raise UnknownNameError("named state", step.move, states, file=where, element=f"task/{i}")

    # --- the world ---
    def draw(self, seed: int) -> dict[str, dict[str, float]]:
        """Draw random properties of a cell's objects, such as position offsets and mass. The seed determines
        all values.

        Returns:
            Per object, those of dx, dy [m], yaw_deg [deg], mass [kg] and friction that are randomized.
        """
        rng = np.random.default_rng(seed)
        values: dict[str, dict[str, float]] = {}
        for name, spec in self.spec.randomize.items():
            ranges = {k: v for k, v in spec.model_dump().items() if v is not None}
            values[name] = {k: round(float(rng.uniform(*v)), 6) for k, v in ranges.items()}
        return values

    def scene(self, seed: int | None = None) -> PlanningScene:
        """Return a cell's planning scene at the start of a run.
        A seed randomizes it; without a seed all values are nominal.
        """
        draw = self.draw(seed) if seed is not None else {}
        scene = PlanningScene.of(self.model).with_padding(self.spec.padding)
        for group, state in self.spec.start.items():
            scene = scene.with_state(self.model.named_state(group, state))
        for name, spec in self.spec.objects.items():
            try:
                item = _varied(object_of(name, spec, self.file.parent), draw.get(name, {}))
                scene = _with_screwed(scene, item) if item.thread is not None else scene.with_object(item)
            except InputError as error:
                if error.file is not None:
                    raise
                raise self._fail(f"objects/{name}", error.reason, error.hint) from None
        if seed is not None and self.spec.drop is not None:
            scene = drop_objects(scene, self.spec.drop.objects, self.spec.drop.into, seed)
        return scene

    def displaced_objects(self, mode: str) -> list[str]:
        """Return the movable objects of a cell that a disturbance displaces without the planner's knowledge.

        The task uses their poses from the cell file until a camera or a gripper detects the displacement.
        """
        moves = self.disturbances.moves if mode == "sim" else ()
        blind = self.spec.perception.objects if self.spec.perception is not None else []
        return [m.object for m in moves if self.spec.objects[m.object].movable and m.object not in blind]

    def connect(
        self,
        mode: str = "sim",
        seed: int | None = None,
        observers: Sequence[Observer] = (),
        time_scale: float | None = None,
        settings: TaskSettings | None = None,
        scene: PlanningScene | None = None,
        watch: bool = True,
    ) -> LiveCell:
        """Create a `LiveCell` for this cell. Use it in a `with` block, which connects the driver.

        Args:
            mode: "sim" (physics), "fake" (joints follow commands exactly, no physics) or "real" (the arms of
                the block `real`).
            seed: selects the randomized values and seeds the planners; None: nominal cell, seed 0.
            time_scale: None runs as fast as possible; 1.0 runs in real time.
            settings: task settings instead of the cell's own.
            scene: initial planning scene instead of the cell's own.
            watch: compare real arms with their simulated twin if thresholds were learned (`armcell twin`).
        Raises:
            UnknownNameError: the mode does not exist.
            InputError: with `calibration: apply`, a robot does not answer or does not match the cell.
        """
        factory = drivers[mode]
        scene = self.scene(seed) if scene is None else scene
        if mode == "real" and self.spec.real:
            scene = with_robot_calibration(scene, self.spec.real)
        options = DriverOptions(
            seed or 0, time_scale, self.physics, self.cameras, self.decals, extra={"real": self.spec.real}
        )
        if mode == "sim" and self.disturbances:
            factory = partial(DisturbedSim, disturbances=self.disturbances)
        driver, seen = factory(scene, options), None
        if driver.wants_guard:
            driver.guard = twin_guard(self, scene, watch)
        look = self.spec.perception
        blind = look.objects if look is not None else []
        moved = self.displaced_objects(mode)
        if blind or moved:
            # hide the true poses: use the world origin as a placeholder
            known = {n: scene.object(n).at(SE3.identity()) for n in (*blind, *moved)}
            initial = {n: scene.object(n).T_world_object for n in moved}
            seen = DetectedPoses(known, look.surface if look is not None else None, initial=initial)
            driver = PerceivingDriver(driver, scene.model, seen)
        live = LiveCell(
            self.name, scene, driver, settings or self.settings, observers, seed or 0, self.cameras,
            self.decals, seen,
        )  # fmt: skip
        if look is not None:
            live.ctx.look = partial(LiveCell.look, weakref.proxy(live), look.camera)
        live.sensors, live.planner_configs = self.sensors, self.planner_configs
        return live


def _with_screwed(scene: PlanningScene, item: CollisionObject) -> PlanningScene:
    """Return the cell's scene with one more object, which is screwed into another object.

    The pose of the added object is in the frame of the other object. Contact between both is allowed.
    """
    assert item.thread is not None
    return scene.with_object(screwed(item, scene.objects)).with_allowed(item.name, item.thread.into)


def _varied(item: CollisionObject, values: dict[str, float]) -> CollisionObject:
    if not values:
        return item
    T = item.T_world_object
    yaw = SO3.exp((0.0, 0.0, np.deg2rad(values.get("yaw_deg", 0.0))))
    moved = T.translation + np.array([values.get("dx", 0.0), values.get("dy", 0.0), 0.0])
    return replace(
        item,
        T_world_object=SE3(yaw @ T.rotation, moved),
        mass=values.get("mass", item.mass),
        material=_with_friction(item.material, values.get("friction")),
    )


def _with_friction(material: Material, static: float | None) -> Material:
    """Return the material of a cell's object with a new coefficient of static friction. The dynamic friction
    changes in proportion.
    """
    if static is None:
        return material
    if material.dynamic_friction is None or material.friction == 0:
        return replace(material, friction=static)
    return material.scaled(static / material.friction)

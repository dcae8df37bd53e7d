"""A cell: robot, objects, task and settings, loaded from a file; connected, it becomes a `LiveCell`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from armcell.cell.calibrating import as_the_robots_are
from armcell.cell.cameras import camera_of, decal_of
from armcell.cell.disturbing import disturbances_of
from armcell.cell.dropping import dropped
from armcell.cell.live import LiveCell
from armcell.cell.objects_file import object_of, screwed
from armcell.cell.perceiving import PerceivingDriver, Seen
from armcell.cell.schema import CameraSpec, CellSpec, MarkerSpec, validated
from armcell.cell.twin import twin_guard
from armcell.control import DriverOptions, drivers
from armcell.control.disturbances import Disturbances
from armcell.control.drivers.disturbed import DisturbedSim
from armcell.control.drivers.ur import UrDriver
from armcell.core import SE3, SO3, InputError, Observer, UnknownNameError
from armcell.core.checks import settings_from
from armcell.model import Part, RobotModel, compose, load_robot
from armcell.model.files import read_yaml
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import Camera, Decal, PhysicsSettings
from armcell.tasks import TaskSettings

LIBRARY = Path(__file__).parent / "library"
CELL_FILE = "cell.yaml"
T = TypeVar("T")


def cell_names() -> list[str]:
    """Built-in cells."""
    return sorted(p.parent.name for p in LIBRARY.glob(f"*/{CELL_FILE}"))


def load(cell: str | Path, allow_env: bool | None = None) -> Cell:
    """A cell by built-in name, folder with cell.yaml, or YAML file.

    Args:
        allow_env: let the robot's xacro files read environment variables, see `load_robot`.
    Raises:
        InputError: with file, element, reason and cure.
    """
    if isinstance(cell, str) and cell in cell_names():
        file = LIBRARY / cell / CELL_FILE
    else:
        path = Path(cell)
        file = path / CELL_FILE if os.path.isdir(path) else path
        if not os.path.exists(file) and isinstance(cell, str) and "/" not in cell and "." not in cell:
            raise UnknownNameError("cell", cell, cell_names())
    name = file.resolve().parent.name if file.name == CELL_FILE else file.stem
    return Cell(name, file, validated(read_yaml(file), file), allow_env=allow_env)


class Cell:
    """A loaded cell. Immutable; a seed chooses one draw of what it randomises."""

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
        self.physics: PhysicsSettings = self._settings(PhysicsSettings, spec.physics, "physics")
        self._check_names()
        self.disturbances: Disturbances = disturbances_of(spec, self.model, self.file)
        self.scene()  # whatever is wrong with the objects is said now
        self.cameras = tuple(self._camera(n, c) for n, c in spec.cameras.items())
        self.decals = tuple(self._decal(n, m) for n, m in spec.markers.items())

    def _fail(self, element: str, reason: str, cure: str | None = None) -> InputError:
        return InputError(reason, file=self.file, element=element, cure=cure)

    def _robot(self) -> RobotModel:
        spec = self.spec.robot
        try:
            model = load_robot(spec.model, self.file.parent, self.allow_env)
            if spec.pose is None:
                return model
            return compose(model.name, [Part(model, T_parent_root=SE3.from_mapping(spec.pose, "robot/pose"))])
        except InputError as error:
            raise self._fail("robot", str(error)) from None

    def _settings(self, cls: type[T], values: dict[str, Any], element: str) -> T:
        for field in fields(cls):  # type: ignore[arg-type]  # blocks within first: named by their own place
            if is_dataclass(field.default) and field.name in values:
                self._settings(type(field.default), values[field.name], f"{element}/{field.name}")
        try:
            return settings_from(cls, values, element)
        except InputError as error:
            raise self._fail(element, error.reason, error.cure) from None

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
            raise self._fail(f"cameras/{name}", error.reason, error.cure) from None

    def _decal(self, name: str, spec: MarkerSpec) -> Decal:
        try:
            return decal_of(name, spec, [*self.model.links, *self.spec.objects])
        except InputError as error:
            raise self._fail(f"markers/{name}", error.reason, error.cure) from None

    def _check_names(self) -> None:
        """Names in randomize, start and task that do not exist."""
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
                cure = "take 'depth: false' away, or name another camera"
                raise self._fail("perception", f"camera {seen.camera!r} has no depth", cure)
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
            if step.camera is not None and step.camera not in spec.cameras:
                raise UnknownNameError("camera", step.camera, spec.cameras, file=where, element=f"task/{i}")
            names = [step.pick] if step.pick else [step.goal.object, step.goal.on] if step.goal else []
            for name in names:
                if name not in spec.objects:
                    raise UnknownNameError("object", name, spec.objects, file=where, element=f"task/{i}")
            states = {s for group in self.model.named_states.values() for s in group}
            if step.move is not None and step.move not in states:
                raise UnknownNameError("named state", step.move, states, file=where, element=f"task/{i}")

    # --- the world ---
    def draw(self, seed: int) -> dict[str, dict[str, float]]:
        """The randomised values of a seed, by object: dx, dy [m], yaw_deg, mass [kg], friction."""
        rng = np.random.default_rng(seed)
        values: dict[str, dict[str, float]] = {}
        for name, spec in self.spec.randomize.items():
            ranges = {k: v for k, v in spec.model_dump().items() if v is not None}
            values[name] = {k: round(float(rng.uniform(*v)), 6) for k, v in ranges.items()}
        return values

    def scene(self, seed: int | None = None) -> PlanningScene:
        """The planning scene at the start; nominal without a seed."""
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
                raise self._fail(f"objects/{name}", error.reason, error.cure) from None
        if seed is not None and self.spec.drop is not None:
            scene = dropped(scene, self.spec.drop.objects, self.spec.drop.into, seed)
        return scene

    def moved_unseen(self, mode: str) -> list[str]:
        """Movable objects that a disturbance puts elsewhere: the task believes them where the cell file has
        them, until a camera or a hand tells otherwise."""
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
        """A live cell, to be used in a `with` block.

        Args:
            mode: "sim" (physics), "fake" (follows exactly, no physics) or "real" (the block `real`'s arms).
            seed: draw of the randomised values and seed of the planners; nominal cell and 0 when None.
            time_scale: None runs as fast as it can; 1.0 in real time.
            scene: begin in this one instead of the cell's own.
            watch: compare real arms with their twin, where its bands were learned (`armcell twin`).
        Raises:
            UnknownNameError: no such mode.
            InputError: with `calibration: apply`, what is wrong with the robots.
        """
        factory = drivers[mode]
        scene = self.scene(seed) if scene is None else scene
        if mode == "real" and self.spec.real:
            scene = as_the_robots_are(scene, self.spec.real)
        options = DriverOptions(
            seed or 0, time_scale, self.physics, self.cameras, self.decals, extra={"real": self.spec.real}
        )
        if mode == "sim" and self.disturbances:
            factory = partial(DisturbedSim, disturbances=self.disturbances)
        driver, seen = factory(scene, options), None
        if isinstance(driver, UrDriver) and driver.settings.twin:
            driver.guard = twin_guard(self, scene, watch)
        shown: Any = driver
        look = self.spec.perception
        blind = look.objects if look is not None else []
        moved = self.moved_unseen(mode)
        if blind or moved:
            # where they are is not told: as if they stood at the origin of the world
            known = {n: scene.object(n).at(SE3.identity()) for n in (*blind, *moved)}
            told = {n: scene.object(n).T_world_object for n in moved}
            seen = Seen(known, look.surface if look is not None else None, told=told)
            shown = PerceivingDriver(driver, scene.model, seen)
        return LiveCell(
            self.name, scene, shown, settings or self.settings, observers, seed or 0, self.cameras,
            self.decals, seen,
        )  # fmt: skip


def _with_screwed(scene: PlanningScene, item: CollisionObject) -> PlanningScene:
    """A scene with an object that is screwed into one that is there; its pose is in that one's frame."""
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
        material=replace(item.material, friction=values.get("friction", item.material.friction)),
    )


@dataclass(frozen=True)
class CellSummary:
    """For listings."""

    name: str
    description: str


def built_in_cells() -> list[CellSummary]:
    return [
        CellSummary(n, str(read_yaml(LIBRARY / n / CELL_FILE).get("description", ""))) for n in cell_names()
    ]

"""The cell file: what may stand in cell.yaml, checked with messages that name the place."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from armcell.core import InputError, UnknownNameError

Range = tuple[float, float]


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ShapeSpec(Strict):
    """One shape: exactly one of the keys. Sizes in metres; lengths are full lengths."""

    box: tuple[float, float, float] | None = None
    sphere: float | None = None  # radius
    cylinder: tuple[float, float] | None = None  # radius, length
    capsule: tuple[float, float] | None = None  # radius, length of the straight part
    cone: tuple[float, float] | None = None  # radius, length
    plane: Literal[True] | None = None
    mesh: str | None = None  # file, relative to the cell folder, or package://
    mesh_scale: float = Field(1.0, gt=0)
    cloud: str | None = None  # file of points (.ply, .pcd, .xyz, .npy) or an octomap (.bt, .ot)
    radius: float | None = Field(None, gt=0)  # [m] of a cloud's points
    pose: Any = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _one(self):
        given = [k for k in SHAPE_KEYS if getattr(self, k) is not None]
        if len(given) != 1:
            raise ValueError(
                f"needs exactly one of {', '.join(SHAPE_KEYS)}, has {', '.join(given) or 'none'}"
            )
        return self


SHAPE_KEYS = ("box", "sphere", "cylinder", "capsule", "cone", "plane", "mesh", "cloud")


class TypeSpec(Strict):
    """What an object is an instance of: a key in a database."""

    key: str = ""
    db: str = ""


class ObjectSpec(Strict):
    """An object: one shape given directly, or several under `shapes`."""

    box: tuple[float, float, float] | None = None
    sphere: float | None = None
    cylinder: tuple[float, float] | None = None
    capsule: tuple[float, float] | None = None
    cone: tuple[float, float] | None = None
    plane: Literal[True] | None = None
    mesh: str | None = None
    mesh_scale: float = Field(1.0, gt=0)
    cloud: str | None = None
    radius: float | None = Field(None, gt=0)
    shapes: list[ShapeSpec] = []
    subframes: dict[str, Any] = {}  # name -> pose in the object's frame
    type: TypeSpec = TypeSpec()
    pose: Any = (0.0, 0.0, 0.0)
    color: tuple[float, float, float, float] | tuple[float, float, float] = (0.6, 0.6, 0.6)
    movable: bool = False
    mass: float | None = None  # [kg]
    friction: float | None = None

    def shape_specs(self) -> list[ShapeSpec]:
        own = {k: getattr(self, k) for k in SHAPE_KEYS if getattr(self, k) is not None}
        if own and self.shapes:
            raise ValueError("has a shape of its own and 'shapes': give one or the other")
        return self.shapes or [ShapeSpec(**own, mesh_scale=self.mesh_scale, radius=self.radius)]

    @model_validator(mode="after")
    def _shaped(self):
        self.shape_specs()
        return self


class RandomSpec(Strict):
    """Ranges [low, high] drawn uniformly per seed. Offsets are added to the object's pose."""

    dx: Range | None = None  # [m]
    dy: Range | None = None  # [m]
    yaw_deg: Range | None = None
    mass: Range | None = None  # [kg]
    friction: Range | None = None

    @field_validator("*")
    @classmethod
    def _ordered(cls, value, info):
        if value is not None:
            low, high = value
            if not low <= high:
                raise ValueError(f"range [{low:g}, {high:g}] is empty")
            if info.field_name in ("mass", "friction") and low <= 0:
                raise ValueError(f"{info.field_name} must be positive")
        return value


class RobotSpec(Strict):
    model: str
    pose: Any = None


class CameraSpec(Strict):
    """A camera that looks from `eye` at `target` [m]."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    width: int = Field(640, ge=16, le=4096)
    height: int = Field(480, ge=16, le=4096)
    fovy_deg: float = Field(45.0, gt=1, lt=170)

    @model_validator(mode="after")
    def _looks_somewhere(self):
        if self.eye == self.target:
            raise ValueError("eye and target are the same point")
        return self


class PlaceSpec(Strict):
    object: str
    on: str
    at: tuple[float, float] | None = None  # [m] on the surface, from its centre


class StepSpec(Strict):
    """One step of the task: exactly one of the keys."""

    pick: str | None = None
    place: PlaceSpec | None = None
    hold: float | None = Field(None, ge=0)  # [s]
    move: str | None = None  # named state of the arm

    @model_validator(mode="after")
    def _one(self):
        given = [k for k in ("pick", "place", "hold", "move") if getattr(self, k) is not None]
        if len(given) != 1:
            raise ValueError("needs exactly one of pick, place, hold, move")
        return self


class CellSpec(Strict):
    """A whole cell file."""

    description: str = ""
    robot: RobotSpec
    start: dict[str, str] = {}  # group -> named state
    padding: float = Field(0.005, ge=0, le=0.2)  # [m]
    objects: dict[str, ObjectSpec] = {}
    randomize: dict[str, RandomSpec] = {}
    cameras: dict[str, CameraSpec] = {}
    task: list[StepSpec] = []
    settings: dict[str, Any] = {}  # of tasks.TaskSettings
    physics: dict[str, Any] = {}  # of sim.PhysicsSettings
    real: dict[str, Any] = {}  # of the UR driver's RealSettings

    @field_validator("robot", mode="before")
    @classmethod
    def _robot(cls, value):
        return {"model": value} if isinstance(value, str) else value


def validated(data: dict[str, Any], file: Path) -> CellSpec:
    """The cell of a parsed YAML file.

    Raises:
        InputError: the first thing that is wrong, with file, place in the file and reason.
    """
    try:
        return CellSpec.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = "/".join(str(part) for part in first["loc"]) or "top level"
        if first["type"] == "extra_forbidden":
            known = _known_keys(first["loc"])
            if known:
                raise UnknownNameError("key", first["loc"][-1], known, file=file, element=place) from None
        more = len(error.errors()) - 1
        reason = first["msg"].removeprefix("Value error, ") + (f" (and {more} more)" if more else "")
        raise InputError(reason, file=file, element=place) from None


def _known_keys(location: tuple) -> list[str]:
    """Keys that may stand where an unknown one does."""
    tables = {
        "objects": ObjectSpec,
        "randomize": RandomSpec,
        "cameras": CameraSpec,
        "robot": RobotSpec,
        "task": StepSpec,
    }
    if len(location) == 1:
        return list(CellSpec.model_fields)
    if "shapes" in location:
        return list(ShapeSpec.model_fields)
    if "place" in location:
        return list(PlaceSpec.model_fields)
    model = tables.get(str(location[0]))
    return list(model.model_fields) if model else []

"""The cell file: what may stand in cell.yaml, checked with messages that name the place."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import (
    AliasChoices,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from armcell.core import InputError, UnknownNameError

Range = tuple[float, float]


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


SCALE = Field(1.0, gt=0, validation_alias=AliasChoices("mesh_scale", "scale"))


class ShapeSpec(Strict):
    """One shape: exactly one of the keys. Sizes in metres; lengths are full lengths."""

    box: tuple[float, float, float] | None = None
    sphere: float | None = None  # radius
    cylinder: tuple[float, float] | None = None  # radius, length
    capsule: tuple[float, float] | None = None  # radius, length of the straight part
    cone: tuple[float, float] | None = None  # radius, length
    plane: Literal[True] | None = None
    mesh: str | None = None  # file, relative to the cell folder, or package://
    mesh_scale: float = SCALE
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


class ThreadSpec(Strict):
    """A thread: the object turns about its z axis and goes in by `pitch` per turn."""

    into: str  # an object that stands before it in the file
    pitch: float = Field(gt=0)  # [m]
    travel: float = Field(gt=0)  # [m]
    torque: float = Field(0.2, ge=0)  # [Nm] of friction


class ObjectSpec(Strict):
    """An object: one shape given directly, several under `shapes`, or one of the library's by `model`."""

    box: tuple[float, float, float] | None = None
    sphere: float | None = None
    cylinder: tuple[float, float] | None = None
    capsule: tuple[float, float] | None = None
    cone: tuple[float, float] | None = None
    plane: Literal[True] | None = None
    mesh: str | None = None
    mesh_scale: float = SCALE  # of a mesh or of a library object
    cloud: str | None = None
    radius: float | None = Field(None, gt=0)
    shapes: list[ShapeSpec] = []
    model: str | None = None  # name of a library object
    sizes: dict[str, float] = {}  # [m] of the library object
    subframes: dict[str, Any] = {}  # name -> pose in the object's frame
    type: TypeSpec = TypeSpec()
    belt: tuple[float, float, float] | None = None  # [m/s] of a fixed object's surface, in its frame
    thread: ThreadSpec | None = None  # then the pose is in the frame of the object it is screwed into
    pose: Any = (0.0, 0.0, 0.0)
    color: tuple[float, float, float, float] | tuple[float, float, float] | None = None
    movable: bool = False
    mass: float | None = None  # [kg]
    density: float | None = Field(None, gt=0)  # [kg/m^3], where no mass is given
    friction: float | None = None

    def shape_specs(self) -> list[ShapeSpec]:
        own = {k: getattr(self, k) for k in SHAPE_KEYS if getattr(self, k) is not None}
        if own and self.shapes:
            raise ValueError("has a shape of its own and 'shapes': give one or the other")
        return self.shapes or [ShapeSpec(**own, mesh_scale=self.mesh_scale, radius=self.radius)]

    @model_validator(mode="after")
    def _shaped(self):
        if self.model is None:
            self.shape_specs()
            if self.sizes:
                raise ValueError("'sizes' are of a library object: it needs 'model'")
        elif self.shapes or any(getattr(self, k) is not None for k in SHAPE_KEYS):
            raise ValueError("has a shape of its own and 'model': give one or the other")
        if self.mass is not None and self.density is not None:
            raise ValueError("has a mass and a density: give one or the other")
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


class IntrinsicsSpec(Strict):
    """Focal lengths and principal point [px]; pixels have whole numbers at their centres."""

    fx: float = Field(gt=0)
    fy: float = Field(gt=0)
    cx: float
    cy: float


class NoiseSpec(Strict):
    """Fields of sim.DepthNoise."""

    floor: float = Field(0.0, ge=0)  # [m]
    growth: float = Field(0.0, ge=0)  # [1/m]
    step: float = Field(0.0, ge=0)  # [m]
    step_growth: float = Field(0.0, ge=0)  # [1/m]
    dropout: float = Field(0.0, ge=0, le=1)
    edge_dropout: float = Field(0.0, ge=0, le=1)
    nearest: float = Field(0.0, ge=0)  # [m]
    farthest: float = Field(1e6, gt=0)  # [m]


class CameraSpec(Strict):
    """A camera that looks from `eye` at `target` [m], or has a `pose` (optical frame: z forward, y down).

    With `on`, these are in that link's frame and the camera moves with it.
    """

    eye: tuple[float, float, float] | None = None
    target: tuple[float, float, float] | None = None
    pose: Any = None
    on: str | None = None  # link
    width: int = Field(640, ge=16, le=4096)
    height: int = Field(480, ge=16, le=4096)
    fovy_deg: float = Field(45.0, gt=1, lt=170)
    intrinsics: IntrinsicsSpec | None = None  # instead of fovy_deg
    info: str | None = None  # file of ROS's camera_calibration, instead of size and fovy_deg
    rate: float = Field(30.0, gt=0, le=1000)  # [Hz]
    depth: bool = True
    noise: Literal["none", "stereo"] | NoiseSpec = "none"

    @model_validator(mode="after")
    def _looks_somewhere(self):
        if (self.eye is None) != (self.target is None) or (self.eye is None) == (self.pose is None):
            raise ValueError("needs eye and target, or a pose")
        if self.eye is not None and self.eye == self.target:
            raise ValueError("eye and target are the same point")
        given = self.model_fields_set
        if self.info is not None and given & {"width", "height", "fovy_deg", "intrinsics"}:
            raise ValueError("has info and also width, height, fovy_deg or intrinsics: give one or the other")
        if self.intrinsics is not None and "fovy_deg" in given:
            raise ValueError("has intrinsics and fovy_deg: give one or the other")
        return self


class MarkerSpec(Strict):
    """An ArUco marker or AprilTag, for cameras. Its frame: x right, y up in its picture, z out of it."""

    family: str
    id: int = Field(ge=0)
    size: float = Field(gt=0, le=2.0)  # [m] edge of the black square
    on: str = "world"  # link, object or "world"
    pose: Any = (0.0, 0.0, 0.0)  # in that frame


class PerceptionSpec(Strict):
    """Objects whose poses come from a camera only: the planner does not know of them before a `look`."""

    camera: str
    objects: list[str] = Field(min_length=1)
    surface: str | None = None  # fixed object that they stand on


class DropSpec(Strict):
    """Objects that physics drops into a bin before the task begins, otherwise with each seed."""

    into: str  # fixed object with a level floor
    objects: list[str] = Field(min_length=1)


class PlaceSpec(Strict):
    object: str
    on: str
    at: tuple[float, float] | None = None  # [m] on the surface, from its centre
    up: tuple[float, float, float] | None = None  # in the object's frame; None: as it stands


class TransferSpec(PlaceSpec):
    look: str | None = None  # camera that looks for the object before every pick


class StepSpec(Strict):
    """One step of the task: exactly one of the keys."""

    pick: str | None = None
    place: PlaceSpec | None = None
    transfer: TransferSpec | None = None  # pick and place, again until it lies there
    hold: float | None = Field(None, ge=0)  # [s]
    move: str | None = None  # named state; of several arms, each that has it moves there in turn
    look: str | None = None  # camera

    @model_validator(mode="after")
    def _one(self):
        given = [k for k in type(self).model_fields if getattr(self, k) is not None]
        if len(given) != 1:
            raise ValueError(f"needs exactly one of {', '.join(type(self).model_fields)}")
        return self

    @property
    def goal(self) -> PlaceSpec | None:
        """What is to lie where after this step."""
        return self.place or self.transfer

    @property
    def camera(self) -> str | None:
        """What is looked with."""
        return self.transfer.look if self.transfer else self.look


class PushSpec(Strict):
    """A force from outside on a link or a movable object, at its centre of mass, in world axes."""

    on: str
    at: float = Field(ge=0)  # [s]
    duration: float = Field(gt=0)  # [s]
    force: tuple[float, float, float]  # [N]


class MovedSpec(Strict):
    """An object that stands elsewhere than planners believe: from `at` on, by so much from where it was."""

    by: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] in world axes
    turn_deg: float = 0.0  # about the upright axis through its origin
    at: float = Field(0.0, ge=0)  # [s]


class DisturbanceSpec(Strict):
    """What is wrong with the simulated robot and what happens to it; real ones bring their own."""

    joint_offset_deg: dict[str, float] = {}  # joint -> how much further it stands than its encoder says
    joint_noise_deg: float = Field(default=0.0, ge=0)  # standard deviation of measured positions
    latency: float = Field(default=0.0, ge=0, le=1)  # [s] from a command until the arm acts
    pushes: dict[str, PushSpec] = {}
    moved: dict[str, MovedSpec] = {}  # by object


class CellSpec(Strict):
    """A whole cell file."""

    description: str = ""
    robot: RobotSpec
    start: dict[str, str] = {}  # group -> named state
    padding: float = Field(0.005, ge=0, le=0.2)  # [m]
    objects: dict[str, ObjectSpec] = {}
    randomize: dict[str, RandomSpec] = {}
    cameras: dict[str, CameraSpec] = {}
    markers: dict[str, MarkerSpec] = {}
    perception: PerceptionSpec | None = None
    drop: DropSpec | None = None
    task: list[StepSpec] = []
    script: str | None = None  # instead of `task`: a Python file beside this one with a function task(cell)
    settings: dict[str, Any] = {}  # of tasks.TaskSettings
    physics: dict[str, Any] = {}  # of sim.PhysicsSettings
    disturbances: DisturbanceSpec = DisturbanceSpec()
    real: dict[str, Any] = {}  # of the UR driver's RealSettings

    @field_validator("robot", mode="before")
    @classmethod
    def _robot(cls, value):
        return {"model": value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _one_task(self):
        if self.task and self.script is not None:
            raise ValueError("has a task and a script: give one or the other")
        return self


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
        cure = f"{first['input']} is none: give one" if first["type"] == "finite_number" else None
        raise InputError(reason, file=file, element=place, cure=cure) from None


def _known_keys(location: tuple) -> list[str]:
    """Keys that may stand where an unknown one does."""
    tables = {
        "objects": ObjectSpec,
        "randomize": RandomSpec,
        "cameras": CameraSpec,
        "markers": MarkerSpec,
        "robot": RobotSpec,
        "task": StepSpec,
    }
    if len(location) == 1:
        return list(CellSpec.model_fields)
    if "shapes" in location:
        return list(ShapeSpec.model_fields)
    if location[0] == "perception":
        return list(PerceptionSpec.model_fields)
    if location[0] == "drop":
        return list(DropSpec.model_fields)
    if location[0] == "disturbances":
        block = {"pushes": PushSpec, "moved": MovedSpec}.get(str(location[1]), DisturbanceSpec)
        return list(block.model_fields)
    if "place" in location:
        return list(PlaceSpec.model_fields)
    model = tables.get(str(location[0]))
    return list(model.model_fields) if model else []

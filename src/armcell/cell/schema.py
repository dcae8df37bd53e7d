"""The schema of the cell file (cell.yaml)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import (
    AliasChoices,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    create_model,
    field_validator,
    model_validator,
)

from armcell.core import ShapeKind, shapes

Range = tuple[float, float]


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


SCALE = Field(1.0, gt=0, validation_alias=AliasChoices("mesh_scale", "scale"))

_SIZED = shapes.imported()
SHAPE_KEYS = (*_SIZED, "mesh", "cloud")


def _value_type(kind: ShapeKind) -> Any:
    """Return the Python type for a shape's dimensions in a cell file: several sizes [m], a single size [m],
    or `true` for a shape without sizes.
    """
    if not kind.sizes:
        return Literal[True]
    return float if len(kind.sizes) == 1 else tuple[(float,) * len(kind.sizes)]


_SIZED_FIELDS: dict[str, Any] = {name: (_value_type(kind) | None, None) for name, kind in _SIZED.items()}
_Sized: Any = create_model("_Sized", __base__=Strict, **_SIZED_FIELDS)


class SomeShape(_Sized, Strict):
    """Cell file schema for at most one shape, as a part of another entry. The keys are the names of armcell's
    shapes.

    Attributes:
        package_shape: value by name of a shape of an installed package; cell files have the name as key.
    """

    mesh: str | None = None  # file, relative to the cell folder, or package://
    mesh_scale: float = SCALE  # scale of a mesh or a library object
    cloud: str | None = None  # file of points (.ply, .pcd, .xyz, .npy) or an octomap (.bt, .ot)
    radius: float | None = Field(None, gt=0)  # [m] radius of a cloud's points
    package_shape: dict[str, float | list[float]] = Field({}, exclude=True)

    @model_validator(mode="before")
    @classmethod
    def _find_package_shapes(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        unknown = [k for k in data if k not in cls.model_fields and k != "scale" and isinstance(k, str)]
        found = {k: data[k] for k in unknown if k in shapes}
        if not found:
            return data
        return {**{k: v for k, v in data.items() if k not in found}, "package_shape": found}

    @classmethod
    def known_keys(cls) -> list[str]:
        """Return the keys of a shape specification in a cell file, with the shapes of installed packages."""
        return [k for k in cls.model_fields if k != "package_shape"] + [k for k in shapes if k not in _SIZED]

    def given(self) -> dict[str, Any]:
        """Return the shape keys and their values in a shape specification of a cell file."""
        own = {key: value for key in SHAPE_KEYS if (value := getattr(self, key)) is not None}
        return {**own, **self.package_shape}

    def sized(self) -> tuple[str, list[float]] | None:
        """Return the name and sizes [m] of a shape in a cell file; None for a mesh, a cloud or no shape."""
        for name, value in self.given().items():
            if name in ("mesh", "cloud"):
                return None
            if value is True:
                return name, []
            return name, [float(v) for v in (value if isinstance(value, Sequence) else [value])]
        return None


class ShapeSpec(SomeShape):
    """Cell file schema for one shape of an object: exactly one shape key, with full lengths in meters."""

    pose: Any = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _one(self):
        given = self.given()
        if len(given) != 1:
            has = ", ".join(given) or "none"
            raise ValueError(f"needs exactly one of {', '.join(SHAPE_KEYS)}, has {has}")
        return self


class TypeSpec(Strict):
    """Cell file schema for the type of an object, like ObjectType of ROS's object_recognition_msgs."""

    key: str = ""
    db: str = ""


class ThreadSpec(Strict):
    """Cell file schema for a screw thread: the object turns about its z axis and advances by `pitch` per
    turn.
    """

    into: str  # an object defined earlier in the file
    pitch: float = Field(gt=0)  # [m]
    travel: float = Field(gt=0)  # [m]
    torque: float = Field(0.2, ge=0)  # [Nm] friction torque


class FrictionSpec(Strict):
    """Cell file schema for the coefficients of Coulomb friction: static and dynamic."""

    static: float = Field(ge=0)
    dynamic: float = Field(ge=0)

    @model_validator(mode="after")
    def _ordered(self):
        if self.dynamic > self.static:
            raise ValueError(f"dynamic ({self.dynamic:g}) is above static ({self.static:g})")
        return self


Friction = Annotated[
    Annotated[float, Tag("<number>")] | Annotated[FrictionSpec, Tag("<both>")],
    Discriminator(lambda value: "<both>" if isinstance(value, dict | FrictionSpec) else "<number>"),
]
"""Friction: one coefficient, or a static and a dynamic one."""


class ObjectSpec(SomeShape):
    """Cell file schema for an object: one shape, several under `shapes`,
    or an object from the library under `model`.
    """

    shapes: list[ShapeSpec] = []
    model: str | None = None  # name of a library object
    sizes: dict[str, float] = {}  # [m] sizes of the library object, by name
    subframes: dict[str, Any] = {}  # name -> pose in the object's frame
    type: TypeSpec = TypeSpec()
    belt: tuple[float, float, float] | None = None  # [m/s] surface velocity of a fixed object, object frame
    thread: ThreadSpec | None = None  # if set, the pose is in the frame of `thread.into`
    pose: Any = (0.0, 0.0, 0.0)
    color: tuple[float, float, float, float] | tuple[float, float, float] | None = None
    movable: bool = False
    mass: float | None = None  # [kg]
    density: float | None = Field(None, gt=0)  # [kg/m^3], instead of a mass
    friction: Friction | None = None

    def shape_specs(self) -> list[ShapeSpec]:
        own = self.given()
        if own and self.shapes:
            raise ValueError("has a shape of its own and 'shapes': give one or the other")
        own |= {"mesh_scale": self.mesh_scale, "radius": self.radius}
        return self.shapes or [ShapeSpec.model_validate(own)]

    @model_validator(mode="after")
    def _shaped(self):
        if self.model is None:
            self.shape_specs()
            if self.sizes:
                raise ValueError("'sizes' are of a library object: it needs 'model'")
        elif self.shapes or self.given():
            raise ValueError("has a shape of its own and 'model': give one or the other")
        if self.mass is not None and self.density is not None:
            raise ValueError("has a mass and a density: give one or the other")
        return self


class RandomSpec(Strict):
    """Cell file schema for ranges [low, high] of random values for an object.
    Each seed draws values uniformly from the ranges.

    The offsets are added to the object's pose.
    """

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
    """Cell file schema for camera intrinsics: focal lengths and principal point [px].

    Pixel centers have integer coordinates.
    """

    fx: float = Field(gt=0)
    fy: float = Field(gt=0)
    cx: float
    cy: float


class NoiseSpec(Strict):
    """Cell file schema for a camera's depth noise, with the fields of `sim.DepthNoise`."""

    floor: float = Field(0.0, ge=0)  # [m]
    growth: float = Field(0.0, ge=0)  # [1/m]
    step: float = Field(0.0, ge=0)  # [m]
    step_growth: float = Field(0.0, ge=0)  # [1/m]
    dropout: float = Field(0.0, ge=0, le=1)
    edge_dropout: float = Field(0.0, ge=0, le=1)
    nearest: float = Field(0.0, ge=0)  # [m]
    farthest: float = Field(1e6, gt=0)  # [m]


class CameraSpec(Strict):
    """Cell file schema for a camera, placed by `eye` and `target` [m] or by a `pose`.

    The pose is that of the optical frame (z forward, y down).

    With `on`, these values are in the frame of that link, and the camera moves with the link.
    """

    eye: tuple[float, float, float] | None = None
    target: tuple[float, float, float] | None = None
    pose: Any = None
    on: str | None = None  # link
    width: int = Field(640, ge=16, le=4096)
    height: int = Field(480, ge=16, le=4096)
    fovy_deg: float = Field(45.0, gt=1, lt=170)
    intrinsics: IntrinsicsSpec | None = None  # instead of fovy_deg
    info: str | None = None  # file from ROS's camera_calibration, instead of size and fovy_deg
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
    """Cell file schema for a visual marker that cameras detect: ArUco or AprilTag.

    Marker frame: x to the right and y up in the picture, z out of the picture.
    """

    family: str
    id: int = Field(ge=0)
    size: float = Field(gt=0, le=2.0)  # [m] edge length of the black square
    on: str = "world"  # link, object or "world"
    pose: Any = (0.0, 0.0, 0.0)  # in the frame `on`


class PerceptionSpec(Strict):
    """Cell file schema for perceived objects. A camera measures their poses, so the poses are unknown before
    the first `look`.
    """

    camera: str
    objects: list[str] = Field(min_length=1)
    surface: str | None = None  # fixed object that supports them


class DropSpec(Strict):
    """Cell file schema for objects that the physics simulation drops into a bin.
    The seed determines their poses.
    """

    into: str  # fixed object with a level floor
    objects: list[str] = Field(min_length=1)


Cameras = str | Annotated[list[str], Field(min_length=1)]
"""One camera, or several that look at the same objects from different sides."""


class PlaceSpec(Strict):
    object: str
    on: str
    at: tuple[float, float] | None = None  # [m] on the support surface, from its center
    up: tuple[float, float, float] | None = None  # direction in the object's frame; None: current orientation


class TransferSpec(PlaceSpec):
    look: Cameras | None = None  # cameras that detect the object before every pick


class StepSpec(Strict):
    """Cell file schema for one step of a task. Exactly one of its keys must be given, apart from `arm`."""

    arm: str | None = None  # planning group of the arm, in a cell with several arms
    pick: str | None = None
    place: PlaceSpec | None = None
    transfer: TransferSpec | None = None  # pick and place with recovery
    hold: float | None = Field(None, ge=0)  # [s]
    move: str | None = None  # named state; several arms move one after the other
    look: Cameras | None = None
    stage: dict[str, dict[str, Any]] | None = Field(None, min_length=1, max_length=1)  # name -> its values

    @model_validator(mode="after")
    def _one(self):
        kinds = [k for k in type(self).model_fields if k != "arm"]
        given = [k for k in kinds if getattr(self, k) is not None]
        if len(given) != 1:
            raise ValueError(f"needs exactly one of {', '.join(kinds)}")
        if self.arm is not None and given[0] in ("look", "stage"):
            raise ValueError(f"'{given[0]}' has no 'arm'")
        return self

    @property
    def goal(self) -> PlaceSpec | None:
        """Return the goal placement that a task step specifies under the schema's keys `place` or `transfer`
        of the cell file, or None if the step has no goal.
        """
        return self.place or self.transfer

    @property
    def cameras(self) -> list[str]:
        """Return the cameras that a task step names under the schema's keys `look` or `transfer` of the cell
        file.
        """
        named = self.transfer.look if self.transfer else self.look
        return [named] if isinstance(named, str) else list(named or [])


class PushSpec(Strict):
    """Cell file schema for a disturbance in which an external force pushes a link or a movable object.

    The force acts at the center of mass, in world axes.
    """

    on: str
    at: float = Field(ge=0)  # [s]
    duration: float = Field(gt=0)  # [s]
    force: tuple[float, float, float]  # [N]


class DisplacementSpec(Strict):
    """Cell file schema for a disturbance that moves an object at time `at`.
    The planners are not informed of it.
    """

    by: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] in world axes
    turn_deg: float = 0.0  # about the vertical axis through the object's origin
    at: float = Field(0.0, ge=0)  # [s]


class DisturbanceSpec(Strict):
    """Cell file schema for disturbances: joint offsets, noise, latency, pushes and moved objects."""

    joint_offset_deg: dict[str, float] = {}  # joint -> true position minus measured position
    joint_noise_deg: float = Field(default=0.0, ge=0)  # standard deviation of measured positions
    latency: float = Field(default=0.0, ge=0, le=1)  # [s] delay of each command
    pushes: dict[str, PushSpec] = {}
    moved: dict[str, DisplacementSpec] = {}  # by object


class ControllerSpec(Strict):
    """Cell file schema for an external controller, which executes the motions planned by `serve --plan-only`.
    The entries follow MoveIt's moveit_controllers.yaml.
    """

    type: Literal["FollowJointTrajectory", "JointTrajectory", "GripperCommand"] = "FollowJointTrajectory"
    action_ns: str | None = None  # below the controller's name; default: as in ROS
    joints: list[str] = []
    position: Literal["joint", "width"] = "joint"  # meaning of the position in a GripperCommand
    default: bool = True  # accepted for MoveIt's sake; every listed controller is used


class RosSpec(Strict):
    """Cell file schema for ROS settings: MoveIt's sensor and planner files, and a namespace and name
    remapping for connections to Unity, ROS 1 and ROS 2.
    """

    namespace: str = ""
    remap: dict[str, str] = {}  # armcell's names -> external names
    sensors: str | None = None  # MoveIt's sensors_3d.yaml, relative to the cell folder
    planners: str | None = None  # MoveIt's ompl_planning.yaml, relative to the cell folder


class CellSpec(Strict):
    """Schema for a whole cell file (cell.yaml)."""

    description: str = ""
    robot: RobotSpec
    xacro_args: dict[str, str | bool | int | float] = {}  # of the robot's xacro file
    start: dict[str, str] = {}  # group -> named state
    padding: float = Field(0.005, ge=0, le=0.2)  # [m]
    objects: dict[str, ObjectSpec] = {}
    randomize: dict[str, RandomSpec] = {}
    cameras: dict[str, CameraSpec] = {}
    markers: dict[str, MarkerSpec] = {}
    perception: PerceptionSpec | None = None
    drop: DropSpec | None = None
    task: list[StepSpec] = []
    script: str | None = None  # instead of `task`: a Python file beside this file with a function task(cell)
    settings: dict[str, Any] = {}  # fields of tasks.TaskSettings
    physics: dict[str, Any] = {}  # fields of sim.PhysicsSettings
    disturbances: DisturbanceSpec = DisturbanceSpec()
    real: dict[str, Any] = {}  # fields of drivers.real.RealSettings
    controllers: dict[str, ControllerSpec] = {}  # external controllers, for `serve --plan-only`
    ros: RosSpec = RosSpec()

    @field_validator("robot", mode="before")
    @classmethod
    def _robot(cls, value):
        return {"model": value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _one_task(self):
        if self.task and self.script is not None:
            raise ValueError("has a task and a script: give one or the other")
        return self

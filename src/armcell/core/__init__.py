"""Value types shared by all packages: poses, joints, shapes, requests, results and errors."""

from armcell.core.closed_meshes import is_closed, open_edges, with_small_holes_filled
from armcell.core.clouds import Octree, PointCloud, finite_points
from armcell.core.constraints import (
    WORLD,
    Constraints,
    JointConstraint,
    OrientationConstraint,
    PositionConstraint,
    VisibilityConstraint,
)
from armcell.core.contact import Contact
from armcell.core.errors import ArmcellError, ErrorCode, InputError, MissingExtraError, UnknownNameError
from armcell.core.events import Event, Observer, StateSample
from armcell.core.explanation import Explanation, Suggestion
from armcell.core.geometry import Box, Capsule, Cone, Cylinder, Mesh, Plane, Shape, Sphere
from armcell.core.height_map import HeightMap
from armcell.core.images import CameraImage, Pinhole
from armcell.core.joints import JointPath, JointState, JointTrajectory
from armcell.core.playback import Playback
from armcell.core.registry import Registry
from armcell.core.requests import (
    ADAPTERS,
    CartesianRequest,
    ConstraintGoal,
    Goal,
    JointGoal,
    NamedGoal,
    PlanRequest,
    PoseGoal,
    SequenceRequest,
)
from armcell.core.results import ExecutionResult, IKResult, Outcome, PlanResult
from armcell.core.shape_table import (
    Format,
    ShapeKind,
    SizedMesh,
    SolidPrimitive,
    make_shape,
    named_shapes,
    register_shape,
    shape_kind,
    shape_name,
    shapes,
    simpler_parts,
)
from armcell.core.transforms import SE3, SO3

__all__ = [
    "ADAPTERS",
    "SE3",
    "SO3",
    "WORLD",
    "ArmcellError",
    "Box",
    "CameraImage",
    "Capsule",
    "CartesianRequest",
    "Cone",
    "ConstraintGoal",
    "Constraints",
    "Contact",
    "Cylinder",
    "ErrorCode",
    "Event",
    "ExecutionResult",
    "Explanation",
    "Format",
    "Goal",
    "HeightMap",
    "IKResult",
    "InputError",
    "JointConstraint",
    "JointGoal",
    "JointPath",
    "JointState",
    "JointTrajectory",
    "Mesh",
    "MissingExtraError",
    "NamedGoal",
    "Observer",
    "Octree",
    "OrientationConstraint",
    "Outcome",
    "Pinhole",
    "PlanRequest",
    "PlanResult",
    "Plane",
    "Playback",
    "PointCloud",
    "PoseGoal",
    "PositionConstraint",
    "Registry",
    "SequenceRequest",
    "Shape",
    "ShapeKind",
    "SizedMesh",
    "SolidPrimitive",
    "Sphere",
    "StateSample",
    "Suggestion",
    "UnknownNameError",
    "VisibilityConstraint",
    "finite_points",
    "is_closed",
    "make_shape",
    "named_shapes",
    "open_edges",
    "register_shape",
    "shape_kind",
    "shape_name",
    "shapes",
    "simpler_parts",
    "with_small_holes_filled",
]

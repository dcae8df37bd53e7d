"""Loading of robots by library name, folder or URDF, xacro or MJCF file, and the robots of the library.

A library robot has the source of its description and its availability.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextvars import ContextVar
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from armcell.core import SE3, InputError, Shape, UnknownNameError
from armcell.model.assets import EXTRAS, extra_hint, load_mesh, resolve_uri
from armcell.model.composition import MountedRobot, compose, with_frame, with_whole_fingers
from armcell.model.grippers import Gripper, SuctionCup, SuctionGripper
from armcell.model.limits import with_joint_limits
from armcell.model.robot import Collision, RobotModel, Visual
from armcell.model.setup.arm_detection import with_groups
from armcell.model.setup.gripper_detection import find_grippers
from armcell.model.setup.moveit_config import MoveItConfig, is_moveit_config
from armcell.model.srdf import with_composite_groups, with_srdf
from armcell.model.untrusted_files import parse_xml, read_text, read_yaml
from armcell.model.urdf import load_urdf

LIBRARY = Path(__file__).parent / "library"
ROBOT_FILE = "robot.yaml"
XacroArgs = Mapping[str, str] | None
_SOURCES = ("urdf", "mjcf", "parts")
_KEYS = {
    "name",
    "source",
    *_SOURCES,
    "root",
    "visual_as_collision",
    "srdf",
    "joint_limits",
    "ik_solvers",
    "grippers",
    "frames",
    "groups",
    "states",
    "xacro_args",
    "description",
}
_around: ContextVar[tuple[Path, ...]] = ContextVar("robot files whose parts are being loaded", default=())
KINDS: dict[str, type[Gripper]] = {"jaws": Gripper, "suction": SuctionGripper}
_NO_SUCTION = {f.name for f in fields(Gripper)} - {"arm_group", "group", "tcp_link", "hand_links"}


@dataclass(frozen=True)
class KnownRobot:
    """A robot that can be loaded by name from armcell's library, with the source of its description.

    Attributes:
        source: maker, model, and origin of the description with its license.
        description: web address of the maker's description, if no Python package ships it.
        package: package with the description of the robot or of one of its parts, if the package is missing
            on this machine, otherwise None.
    """

    name: str
    source: str
    description: str = ""
    package: str | None = None

    @property
    def hint(self) -> str:
        """Return a hint on how to install the package whose robot description cannot be loaded. It is empty
        if the package is present.
        """
        if self.package is None:
            return ""
        if self.package in EXTRAS:
            return extra_hint(self.package)
        if not self.description:
            return ""
        return f"get {self.package} from {self.description} and pass --package {self.package}=FOLDER"


def robot_names() -> list[str]:
    """Return the names of the robots that can be loaded from armcell's library."""
    return sorted(p.parent.name for p in LIBRARY.glob(f"*/{ROBOT_FILE}"))


def installed_robots() -> list[str]:
    """Return the names of the robots in armcell's library that can be loaded on this machine, because their
    descriptions are installed.
    """
    return [name for name in robot_names() if known_robot(name).package is None]


def known_robot(name: str) -> KnownRobot:
    """Return a robot's entry in armcell's library, by name. The robot model is not loaded."""
    folder = LIBRARY / name
    data = read_yaml(folder / ROBOT_FILE)
    package, description = None, str(data.get("description", ""))
    uri = str(data.get("urdf", data.get("mjcf", "")))
    if uri.startswith("package://"):
        try:
            resolve_uri(uri, folder)
        except InputError:
            package = uri.removeprefix("package://").split("/")[0]
    parts = [
        known_robot(part["robot"]) for part in data.get("parts", []) if os.path.isdir(LIBRARY / part["robot"])
    ]
    for part in parts:
        if package is None and part.package is not None:
            package, description = part.package, description or part.description
    return KnownRobot(name, str(data.get("source", "")), description, package)


def load_robot(
    robot: str | Path,
    base: Path | None = None,
    allow_env: bool | None = None,
    xacro_args: XacroArgs = None,
) -> RobotModel:
    """Load a robot model from the library, from a folder, or from a URDF, xacro or MJCF file.

    Args:
        robot: a library name (see `robot_names()`), a folder with robot.yaml, a MoveIt configuration package,
            or a URDF, xacro or MJCF (`*.xml`, `*.mjcf`) file. An SRDF file of the same name in the same
            folder is applied, too. An MJCF file without an SRDF gets groups for its arms and grippers.
        base: folder that relative paths start from; by default the current folder.
        allow_env: whether xacro files may read environment variables with `$(env)` and `$(optenv)`. None:
            only if ARMCELL_ALLOW_ENV is set, as `armcell --allow-env` does.
        xacro_args: values for a xacro file's arguments, by name.
    Raises:
        InputError: the robot cannot be loaded; the message contains file, element, reason and hint.
    """
    if isinstance(robot, str) and robot in robot_names():
        return load_folder(LIBRARY / robot, allow_env, xacro_args)
    path = Path(robot)
    if not path.is_absolute() and base is not None:
        path = base / path
    if os.path.isdir(path):  # returns False for invalid names, where Path.is_dir raises
        return load_folder(path, allow_env, xacro_args)
    if path.suffix in (".urdf", ".xacro") or os.path.isfile(path):
        return _load_file(path, allow_env, xacro_args)
    if isinstance(robot, str) and "/" not in robot and "." not in robot:
        raise UnknownNameError("robot", robot, robot_names())
    raise InputError(
        "no such robot file or folder", file=path, hint=f"library robots: {', '.join(robot_names())}"
    )


def _load_file(path: Path, allow_env: bool | None, xacro_args: XacroArgs) -> RobotModel:
    srdf = path.with_name(path.name.removesuffix(".xacro").removesuffix(path.suffix) + ".srdf")
    if is_mjcf(path):
        model = load_mjcf_file(path)
        return with_srdf(model, srdf) if os.path.isfile(srdf) else with_keyframes(with_groups(model))
    srdf = path.with_name(path.name.removesuffix(".xacro").removesuffix(".urdf") + ".srdf")
    model = load_urdf(path, allow_env, xacro_args=xacro_args)
    return with_srdf(model, srdf) if os.path.isfile(srdf) else with_adjacent_disabled(model)


def is_mjcf(path: Path) -> bool:
    """Return whether a robot file must be loaded as MJCF. Such a file has the suffix .mjcf, or the suffix
    .xml and the root element <mujoco>.
    """
    if path.suffix.lower() != ".xml":
        return path.suffix.lower() == ".mjcf"
    return parse_xml(read_text(path), path).tag == "mujoco"


def load_mjcf_file(path: Path) -> RobotModel:
    """Load a robot from an MJCF file, and disable collision checks between adjacent links.

    Adjacent links share a joint. See also `load_mjcf`.
    """
    from armcell.model.mjcf import load_mjcf  # imported late: imports MuJoCo, which URDF robots do not need

    return with_adjacent_disabled(load_mjcf(path))


def with_keyframes(model: RobotModel) -> RobotModel:
    """Return a loaded robot with the keyframes of its MJCF file as named states of its planning groups.

    The positions are clipped to the joint limits.

    If no keyframe has the name "home", the first keyframe is also the state "home".
    """
    named = {group: dict(states) for group, states in model.named_states.items()}
    for part in model.mjcf:
        states = dict(part.states)
        if states and "home" not in states:
            states["home"] = next(iter(states.values()))
        for state, positions in states.items():
            for group in model.groups.values():
                values = {j: positions[j] for j in group.joint_names if j in positions}
                if len(values) == len(group.joint_names) > 0:
                    q = model.enforce_bounds(list(values.values()), values)
                    named.setdefault(group.name, {})[state] = dict(zip(values, map(float, q), strict=True))
    return replace(model, named_states=named)


def load_folder(folder: Path, allow_env: bool | None = None, xacro_args: XacroArgs = None) -> RobotModel:
    """Load a robot from a folder with robot.yaml, or from a MoveIt configuration package.

    robot.yaml contains either a URDF or a list of parts that are mounted on each other.
    """
    file = folder / ROBOT_FILE
    if not os.path.isfile(file) and is_moveit_config(folder):
        config = MoveItConfig.load(folder, allow_env=allow_env, xacro_args=xacro_args)
        return with_whole_fingers(find_grippers(config.model))
    data = read_yaml(file)
    for key in data:
        if key not in _KEYS:
            raise UnknownNameError("key", key, _KEYS, file=file)
    if not isinstance(data.get("parts", []), list):
        raise InputError("is not a list", file=file, element="parts")
    if not isinstance(data.get("grippers") or {}, dict):
        raise InputError("is not a mapping", file=file, element="grippers")
    if sum(key in data for key in _SOURCES) != 1:
        raise InputError("needs one of 'urdf', 'mjcf' and 'parts'", file=file)
    for key in ("root", "visual_as_collision"):
        if key in data and "parts" in data:
            hint = "set the key in the robot.yaml of the part"
            raise InputError("does not apply to a robot of parts", file=file, element=key, hint=hint)
    drawn = data.get("visual_as_collision") or []
    if not isinstance(drawn, list) or not all(isinstance(link, str) for link in drawn):
        raise InputError("is not a list of link names", file=file, element="visual_as_collision")
    name = str(data.get("name", folder.resolve().name))  # resolved: independent of the working folder
    if "parts" not in data:
        if "mjcf" in data:
            model = load_mjcf_file(_source_path(data, "mjcf", folder, file))
        else:
            given = {**xacro_texts(data.get("xacro_args"), file), **(xacro_args or {})}
            model = load_urdf(_source_path(data, "urdf", folder, file), allow_env, folder, given, drawn)
        if "root" in data:
            model = rerooted(model, str(data["root"]))
        model = _with_visuals_as_collisions(model, drawn, file)
        model = with_adjacent_disabled(model)
    else:
        parts = [_part(p, folder, file, allow_env) for p in data["parts"]]
        model = compose(name, parts)
    model = replace(model, name=name, source=str(data.get("source", model.source)))
    model = _with_frames(model, data.get("frames") or {}, file)
    if "srdf" in data:
        grippers = model.grippers
        model = replace(with_srdf(model, folder / str(data["srdf"])), grippers=grippers)
    if "joint_limits" in data:
        model = with_joint_limits(model, folder / str(data["joint_limits"]))
    model = with_composite_groups(model, data.get("groups"), data.get("states"), file)
    model = _with_ik_solvers(model, data.get("ik_solvers") or {}, file)
    grippers = dict(model.grippers)
    for name, entry in (data.get("grippers") or {}).items():
        grippers[name] = _gripper(model, name, entry, file)
    return with_whole_fingers(replace(model, grippers=grippers))


def _with_visuals_as_collisions(model: RobotModel, names: list[str], file: Path) -> RobotModel:
    """Return a loaded robot with the visual shapes of some links also as their collision shapes. Some
    descriptions draw a link, but give it no collision shape.
    """
    where = {"file": file, "element": "visual_as_collision"}
    links = dict(model.links)
    built = {name for part in model.mjcf for name in part.links}
    for name in names:
        if name not in links:
            raise UnknownNameError("link", name, links, **where)
        link = links[name]
        if name in built:  # physics uses its body unchanged
            hint = "let its geoms collide (contype, conaffinity)"
            raise InputError(f"link {name!r} is a body of an MJCF file", **where, hint=hint)
        if link.collisions or not link.visuals:
            has = "collision shapes already" if link.collisions else "no visual shapes"
            raise InputError(f"link {name!r} has {has}", **where, hint="omit the link")
        solids = tuple(Collision(_shape(visual), visual.T_link_visual) for visual in link.visuals)
        links[name] = replace(link, collisions=solids)
    return replace(model, links=links)


def _shape(visual: Visual) -> Shape:
    if visual.shape is not None:
        return visual.shape
    assert visual.file is not None  # a visual without a shape has a mesh file
    return load_mesh(visual.file, visual.scale)


def _with_frames(model: RobotModel, frames: Any, file: Path) -> RobotModel:
    """Return a loaded robot with the additional frames in its robot.yaml, given as `{name: {parent_link:
    LINK, pose: POSE}}`.
    """
    if not isinstance(frames, dict):
        raise InputError("is not a mapping", file=file, element="frames")
    for name, entry in frames.items():
        where = {"file": file, "element": f"frames/{name}"}
        if not isinstance(entry, dict) or set(entry) != {"parent_link", "pose"}:
            raise InputError("needs 'parent_link' and 'pose'", **where)
        if entry["parent_link"] not in model.links:
            raise UnknownNameError("link", str(entry["parent_link"]), model.links, **where)
        if name in model.links:
            raise InputError(f"the robot has a link {name!r} already", **where)
        pose = SE3.from_mapping(entry["pose"], f"{file}: frames/{name}")
        model = with_frame(model, str(name), entry["parent_link"], pose)
    return model


def _with_ik_solvers(model: RobotModel, names: Any, file: Path) -> RobotModel:
    """Return a loaded robot with the IK solvers that robot.yaml assigns to its planning groups."""
    if not isinstance(names, dict) or not all(isinstance(name, str) for name in names.values()):
        raise InputError("is not a mapping of groups to solver names", file=file, element="ik_solvers")
    for group in names:
        if group not in model.groups:
            raise UnknownNameError("planning group", group, model.groups, file=file, element="ik_solvers")
    groups = {n: replace(g, ik_solver=names.get(n, g.ik_solver)) for n, g in model.groups.items()}
    return replace(model, groups=groups)


def rerooted(model: RobotModel, link: str) -> RobotModel:
    """Return a loaded robot with a given link as its root. All links above it are removed, such as the link
    "world" of a URDF.
    """
    keep = set(model.subtree(link))
    return replace(
        model,
        root_link=link,
        links={n: v for n, v in model.links.items() if n in keep},
        joints={n: j for n, j in model.joints.items() if j.parent in keep},
    )


def with_adjacent_disabled(model: RobotModel) -> RobotModel:
    """Return a loaded robot with collision checks disabled between links that a joint connects.

    A robot without an SRDF needs at least these pairs, because adjacent links touch at their joint.
    """
    pairs = {frozenset((j.parent, j.child)): "Adjacent" for j in model.joints.values()}
    return replace(model, disabled_collisions={**pairs, **model.disabled_collisions})


def xacro_texts(value: Any, file: Path) -> dict[str, str]:
    """Convert the xacro arguments of a robot to be loaded from YAML values to text. Booleans become `true`
    and `false`.

    Raises:
        InputError: `value` is not a mapping of names to numbers, texts or booleans.
    """
    if not isinstance(value or {}, dict):
        raise InputError("is not a mapping", file=file, element="xacro_args")
    found = {}
    for name, entry in (value or {}).items():
        if not isinstance(entry, str | int | float):
            raise InputError(f"{entry!r} is not a text or number", file=file, element=f"xacro_args/{name}")
        found[str(name)] = str(entry).lower() if isinstance(entry, bool) else str(entry)
    return found


def _source_path(data: dict[str, Any], key: str, folder: Path, file: Path) -> Path:
    try:
        return resolve_uri(str(data[key]), folder)
    except InputError as error:
        hint = known_robot(folder.name).hint if folder.parent == LIBRARY else ""
        raise InputError(error.reason, file=file, element=key, hint=hint or error.hint) from None


def _part(entry: Any, folder: Path, file: Path, allow_env: bool | None) -> MountedRobot:
    if not isinstance(entry, dict) or not isinstance(entry.get("robot"), str):
        raise InputError("each of 'parts' needs a 'robot': a name or a path", file=file, element="parts")
    for key in entry:
        if key not in ("robot", "prefix", "parent_link", "pose"):
            raise UnknownNameError(
                "key", key, ["robot", "prefix", "parent_link", "pose"], file=file, element="parts"
            )
    return MountedRobot(
        _part_robot(entry["robot"], folder, file, allow_env),
        str(entry.get("prefix") or ""),
        str(entry.get("parent_link", "world")),
        SE3.from_mapping(entry.get("pose", [0.0, 0.0, 0.0]), f"{file}: parts: pose"),
    )


def _part_robot(robot: str, folder: Path, file: Path, allow_env: bool | None) -> RobotModel:
    around = _around.get()
    if file.resolve() in around:
        raise InputError(f"part {robot!r} contains itself", file=file, element="parts")
    token = _around.set((*around, file.resolve()))
    try:
        return load_robot(robot, folder, allow_env)
    finally:
        _around.reset(token)


def _curve(rows: Any, where: dict[str, Any]) -> tuple[tuple[float, ...], ...]:
    """Load the opening curve of a gripper from robot.yaml: rows of joint position, width, y and z. The curve
    must be monotonic from closed to open.
    """
    try:
        table = np.array(rows, dtype=float)
        fits = table.ndim == 2 and table.shape[0] >= 2 and table.shape[1] == 4 and np.isfinite(table).all()
    except (TypeError, ValueError):
        fits = False
    if not fits:
        raise InputError("curve needs rows of four numbers: joint position, width, y, z", **where)
    steps = np.diff(table, axis=0)
    if np.any(steps[:, 1] <= 0) or not (np.all(steps[:, 0] > 0) or np.all(steps[:, 0] < 0)):
        raise InputError("curve must go from closed to open: the width grows in every row", **where)
    return tuple(tuple(row) for row in table.tolist())


def _gripper(model: RobotModel, name: str, entry: Any, file: Path) -> Gripper:
    where = {"file": file, "element": f"grippers/{name}"}
    if not isinstance(entry, dict):
        raise InputError("is not a mapping", **where)
    kind = entry.get("kind", "jaws")
    if kind not in KINDS:
        raise UnknownNameError("kind of gripper", kind, KINDS, **where)
    made = KINDS[kind]
    known = {"kind", *(f.name for f in fields(made))} - ({"name"} if kind == "jaws" else _NO_SUCTION)
    for key in entry:
        if key not in known:
            raise UnknownNameError("key", key, known, **where)
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in entry.items()}
    values.pop("kind", None)
    if "curve" in values:
        values["curve"] = _curve(values["curve"], where)
    if "cups" in values:
        values["cups"] = _cups(values["cups"], where)
    try:
        gripper = made(name=name, **values)
    except TypeError as error:
        raise InputError(f"is incomplete: {error}", **where) from None
    except InputError as error:
        raise InputError(error.reason, hint=error.hint, **where) from None
    if gripper.curve and gripper.max_width > gripper.curve[-1][1] + 1e-6:
        text = f"max_width is {gripper.max_width:g} m, but the curve ends at {gripper.curve[-1][1]:g} m"
        raise InputError(text, **where)
    for link in (gripper.tcp_link, *gripper.contact_links, *gripper.hand_links):
        if link not in model.links:
            raise UnknownNameError("link", link, model.links, **where)
    for joint in gripper.joint_names:
        if joint not in model.joint_names:
            raise UnknownNameError("actuated joint", joint, model.joint_names, **where)
    for group in (gripper.arm_group, gripper.group):
        if group not in model.groups:
            raise UnknownNameError("planning group", group, model.groups, **where)
    return gripper


def _cups(rows: Any, where: dict[str, Any]) -> tuple[SuctionCup, ...]:
    """Load the cups of a suction gripper from its entry in robot.yaml."""
    if not isinstance(rows, tuple) or not all(isinstance(row, dict) for row in rows):
        raise InputError("cups must be a list of mappings", **where)
    known = {f.name for f in fields(SuctionCup)}
    cups = []
    for row in rows:
        for key in row:
            if key not in known:
                raise UnknownNameError("key of a cup", key, known, **where)
        values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in row.items()}
        try:
            cups.append(SuctionCup(**values))
        except TypeError as error:
            raise InputError(f"a cup is incomplete: {error}", **where) from None
        except InputError as error:
            raise InputError(error.reason, hint=error.hint, **where) from None
    return tuple(cups)

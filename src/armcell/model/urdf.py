"""URDF parser: builds the links and joints of a `RobotModel`.

Every error message names the file, line, element and hint.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Collection, Mapping, Sequence
from difflib import get_close_matches
from itertools import islice
from pathlib import Path

import numpy as np
from lxml import etree

from armcell.core import SE3, Format, InputError, Mesh, Shape, named_shapes
from armcell.model.assets import load_mesh, package_above, resolve_uri
from armcell.model.multi_dof_joints import single_joints
from armcell.model.robot import Collision, Inertial, Joint, JointLimits, Link, Mimic, RobotModel, Visual
from armcell.model.units import LARGEST_LINK, limit_faults, origin_faults
from armcell.model.untrusted_files import parse_xml, read_text
from armcell.model.xacro import Place, expand_with_source_locations, expand_xacro

logger = logging.getLogger(__name__)

MAX_LISTED = 500  # xacro files of a package that are searched for callers of a macro
JOINT_TYPES = {"revolute", "continuous", "prismatic", "fixed", "floating", "planar"}


def load_urdf(
    path: Path,
    allow_env: bool | None = None,
    home: Path | None = None,
    xacro_args: Mapping[str, str] | None = None,
    drawn: Collection[str] = (),
) -> RobotModel:
    """Load a robot from a URDF or xacro file. The result has no planning groups.

    Args:
        path: the URDF or xacro file.
        allow_env, home, xacro_args: options for xacro files, see `expand_xacro`.
        drawn: names of links whose visual meshes must exist.
    Raises:
        InputError: the file is not readable or not a valid URDF, or a required visual mesh is missing.
    """
    path = Path(path)
    if path.suffix == ".xacro":
        text, places = expand_with_source_locations(path, xacro_args, allow_env, home)
    else:
        text, places = read_text(path), ()
    return _Reader(path, parse_xml(text, path), places, drawn=drawn).robot()


def urdf_text(
    path: Path,
    allow_env: bool | None = None,
    home: Path | None = None,
    xacro_args: Mapping[str, str] | None = None,
) -> str:
    """Return the text of a URDF or SRDF file, expanded if it is a xacro file."""
    path = Path(path)
    is_xacro = path.suffix == ".xacro"
    return expand_xacro(path, xacro_args, allow_env, home) if is_xacro else read_text(path)


def parse_urdf(text: str, file: Path, warn: bool = True) -> RobotModel:
    """Parse URDF text into a robot model.

    Args:
        text: the URDF.
        file: the file's path, for error messages and for mesh paths relative to its folder.
        warn: whether to report implausible limits and inertias and missing visual meshes.
    Raises:
        InputError: the text is not a valid URDF.
    """
    return _Reader(file, parse_xml(text, file), warn=warn).robot()


class _Reader:
    """Parser for one URDF file. Its error messages contain the file name, line and element.

    Args:
        places: of the elements in document order, if the URDF is the result of a xacro file.
        drawn: names of links whose visual meshes must exist.
    """

    def __init__(
        self, file: Path, root: etree._Element, places: Sequence[Place] = (), warn: bool = True,
        drawn: Collection[str] = (),
    ):  # fmt: skip
        self.file, self.root, self.warn, self.drawn = file, root, warn, drawn
        self.folder = file.resolve().parent
        self.places = dict(zip(root.iter(etree.Element), places)) if places else {}
        self.undrawn: list[str] = []  # errors of visual meshes that are missing
        self.joints: dict[str, etree._Element] = {}

    def fail(self, element: etree._Element, reason: str, hint: str | None = None) -> InputError:
        name = element.get("name")
        label = f"<{element.tag}{f' name={name!r}' if name else ''}>"
        file, line = self.place(element)
        if file != self.file:
            reason = f"{reason} (part of {self.file})"
        return InputError(reason, file=file, line=line, element=label, hint=hint)

    def place(self, element: etree._Element) -> tuple[Path, int | None]:
        """Return the file and line of an element of the URDF. If the URDF was expanded from xacro, return its
        place in the xacro source.
        """
        return self.places.get(element, (self.file, element.sourceline))

    def report(self, element: etree._Element, text: str, *values: object) -> None:
        if self.warn:
            logger.warning(f"%s:%s: {text}", *self.place(element), *values)

    def attribute(self, element: etree._Element, name: str) -> str:
        value = element.get(name)
        if value is None or not value.strip():
            raise self.fail(element, f"attribute {name!r} is missing")
        return value

    def numbers(
        self, element: etree._Element, name: str, count: int, default: str | None = None
    ) -> list[float]:
        text = element.get(name, default)
        try:
            values = [float(v) for v in (text or "").split()]
        except ValueError:
            raise self.fail(element, f"{name}={text!r} is not a list of numbers") from None
        if len(values) != count or not np.all(np.isfinite(values)):
            raise self.fail(
                element, f"{name}={text!r} must be {count} finite number{'s' if count > 1 else ''}"
            )
        return values

    def number(self, element: etree._Element, name: str, default: float | None = None) -> float:
        return self.numbers(element, name, 1, None if default is None else repr(default))[0]

    def origin(self, element: etree._Element) -> SE3:
        origin = element.find("origin")
        if origin is None:
            return SE3.identity()
        xyz, rpy = self.numbers(origin, "xyz", 3, "0 0 0"), self.numbers(origin, "rpy", 3, "0 0 0")
        for text in origin_faults(f"<{element.tag}> {element.get('name', '')}".rstrip(), xyz, rpy):
            self.report(origin, "%s", text)
        return SE3.from_xyz_rpy(xyz, rpy)

    def robot(self) -> RobotModel:
        root = self.root
        if root.tag != "robot":
            raise self.fail(root, "root element is not <robot>", hint="is this a URDF file?")
        materials = {m.get("name"): self.color(m) for m in root.findall("material")}
        links: dict[str, Link] = {}
        for element in root.findall("link"):
            link = self.link(element, materials)
            if link.name in links:
                raise self.fail(element, "a second link of this name")
            links[link.name] = link
        if not links:
            raise self.fail(root, "has no <link>", self.without_links())
        if self.undrawn and self.warn:
            logger.warning(
                "%s: %d visual meshes are missing, those links are drawn by their collision shapes (%s)",
                self.file, len(self.undrawn), self.undrawn[0],
            )  # fmt: skip
        joints: dict[str, Joint] = {}
        for element in root.findall("joint"):
            for joint in self.joint(element, links):
                if joint.name in joints:
                    raise self.fail(element, "a second joint of this name")
                joints[joint.name], self.joints[joint.name] = joint, element
        for joint in joints.values():
            self.check_mimic(joint, joints)
        root_link, ordered = self.tree(links, joints)
        name = root.get("name") or self.file.stem
        return RobotModel(name=name, root_link=root_link, links=links, joints=ordered, source=str(self.file))

    def without_links(self) -> str | None:
        """Return a hint for a URDF file that only defines macros and has no links. The hint names the xacro
        files of the same package that include the file.
        """
        if b"macro" not in self.file.read_bytes():
            return None
        package = package_above(self.file.resolve()) or self.folder
        name = self.file.name.encode()
        others = (f for f in sorted(package.rglob("*.xacro")) if f.name != self.file.name)
        files = filter(os.path.isfile, others)
        users = [str(f.relative_to(package)) for f in islice(files, MAX_LISTED) if name in f.read_bytes()]
        callers = f"; {', '.join(users[:5])} include{'s' * (len(users) == 1)} it" if users else ""
        return f"the file only defines macros: give a file that calls them{callers}"

    def check_mimic(self, joint: Joint, joints: dict[str, Joint]) -> None:
        """Check that a mimic joint in a URDF follows an actuated joint, directly or via other mimic joints.

        Raises:
            InputError: the followed joint does not exist or is fixed, or mimic joints follow each other in a
                loop.
        """
        seen, source = {joint.name}, joint
        while source.mimic is not None:
            name = source.mimic.joint
            element = self.joints[joint.name]
            if name not in joints:
                close = get_close_matches(name, joints, 1)
                hint = f"did you mean {close[0]!r}?" if close else "name a joint of this robot"
                raise self.fail(element, f"mimics unknown joint {name!r}", hint)
            if name in seen:
                raise self.fail(
                    element, f"mimics itself ({' -> '.join([*seen, name])})", "let it follow a driven joint"
                )
            if not joints[name].movable:
                raise self.fail(element, f"mimics joint {name!r}, which is fixed", "name a driven joint")
            seen.add(name)
            source = joints[name]

    def tree(self, links: dict[str, Link], joints: dict[str, Joint]) -> tuple[str, dict[str, Joint]]:
        """Return the name of the root link and the joints of a URDF robot in depth-first order.

        Raises:
            InputError: a link has two parents, there is not exactly one root link, or joints form a loop.
        """
        parent: dict[str, str] = {}
        children: dict[str, list[Joint]] = {name: [] for name in links}
        for joint in joints.values():
            if joint.child in parent:
                raise self.fail(
                    self.joints[joint.name],
                    f"link {joint.child!r} is the child of both {parent[joint.child]!r} and {joint.name!r}",
                    hint="a URDF is a tree: cut the loop at one of the joints and couple the passive joints "
                    "to the driven joint with <mimic>; an MJCF file may close the loop",
                )
            parent[joint.child] = joint.name
            children[joint.parent].append(joint)
        roots = [name for name in links if name not in parent]
        if len(roots) != 1:
            if not roots:  # each link has a parent: going up from any link ends in the loop
                up = [next(iter(links))]
                while (link := joints[parent[up[-1]]].parent) not in up:
                    up.append(link)
                around = up[up.index(link) :]
                raise self.loop([n for n in joints if joints[n].child in around], "and no link is the root")
            what = f"has {len(roots)} root links ({', '.join(roots[:5])}), exactly one is needed"
            raise InputError(what, file=self.file, hint="join the parts with fixed joints")
        ordered: dict[str, Joint] = {}
        stack = list(reversed(children[roots[0]]))
        while stack:
            joint = stack.pop()
            ordered[joint.name] = joint
            stack.extend(reversed(children[joint.child]))
        if len(ordered) != len(joints):
            raise self.loop(sorted(set(joints) - set(ordered)), "apart from the root")
        return roots[0], ordered

    def loop(self, names: list[str], where: str) -> InputError:
        text = f"joints {', '.join(names[:5])} form a loop {where}"
        return self.fail(self.joints[names[0]], text, "remove the joint that closes the loop")

    def color(self, material: etree._Element) -> tuple[float, float, float, float] | None:
        color = material.find("color")
        if color is None:
            return None
        opaque = len((color.get("rgba") or "").split()) == 3  # some files leave the opacity out
        r, g, b, a = (*self.numbers(color, "rgba", 3), 1.0) if opaque else self.numbers(color, "rgba", 4)
        return (r, g, b, a)

    def link(self, element: etree._Element, materials: dict) -> Link:
        name = self.attribute(element, "name")
        inertial = element.find("inertial")
        return Link(
            name=name,
            inertial=None if inertial is None else self.inertial(inertial),
            collisions=tuple(Collision(self.shape(c), self.origin(c)) for c in element.findall("collision")),
            visuals=tuple(filter(None, (self.visual(v, materials) for v in element.findall("visual")))),
        )

    def inertial(self, element: etree._Element) -> Inertial:
        mass_element, inertia = element.find("mass"), element.find("inertia")
        if mass_element is None:
            raise self.fail(element, "has no <mass>")
        mass = self.number(mass_element, "value")
        if mass < 0:
            raise self.fail(mass_element, f"mass {mass:g} kg is negative")
        I = np.zeros((3, 3))
        if inertia is not None:
            for (i, j), key in {
                (0, 0): "ixx",
                (0, 1): "ixy",
                (0, 2): "ixz",
                (1, 1): "iyy",
                (1, 2): "iyz",
                (2, 2): "izz",
            }.items():
                I[i, j] = I[j, i] = self.number(inertia, key, 0.0)
        self.check_inertia(element, mass, I)
        return Inertial(mass, self.origin(element), I)

    def check_inertia(self, element: etree._Element, mass: float, inertia: np.ndarray) -> None:
        """Warn if the inertia matrix of a URDF link is physically impossible for its mass.

        Planning does not need the inertia.
        """
        a, b, c = np.linalg.eigvalsh(inertia)
        if mass > 0 and (a <= 0 or a + b < c * (1 - 1e-3) - 1e-9):
            link = element.getparent()
            self.report(
                element,
                "the inertia of link %r is %s (principal moments %.3g, %.3g, %.3g kg m^2; each must be above "
                "0 and at most the sum of the others): check signs and units, physics may be wrong",
                None if link is None else link.get("name"),
                "not of a real body" if inertia.any() else "zero", a, b, c,
            )  # fmt: skip

    def geometry(self, element: etree._Element) -> etree._Element:
        geometry = element.find("geometry")
        if geometry is None or len(geometry) == 0:
            raise self.fail(element, "has no <geometry>")
        return geometry[0]

    def mesh_file(self, geometry: etree._Element) -> tuple[Path, tuple[float, float, float]]:
        sx, sy, sz = self.numbers(geometry, "scale", 3, "1 1 1")
        if 0.0 in (sx, sy, sz):
            raise self.fail(geometry, "mesh scale has a zero")
        try:
            return resolve_uri(self.attribute(geometry, "filename"), self.folder), (sx, sy, sz)
        except InputError as error:
            raise self.fail(geometry, error.reason, error.hint) from None

    def shape(self, element: etree._Element) -> Shape:
        geometry = self.geometry(element)
        sized = named_shapes(Format.URDF_READ)
        try:
            if geometry.tag in sized:
                return sized[geometry.tag].from_named(
                    lambda key: self.number(geometry, key), lambda key, n: self.numbers(geometry, key, n)
                )
            if geometry.tag == "mesh":
                return self.checked_size(geometry, load_mesh(*self.mesh_file(geometry)))
        except InputError as error:
            if error.line is not None:
                raise
            raise self.fail(geometry, str(error)) from None
        raise self.fail(geometry, "unknown geometry", hint=f"{', '.join(sized)} and mesh exist")

    def checked_size(self, geometry: etree._Element, mesh: Mesh) -> Mesh:
        """Check that the mesh of a URDF link has a plausible size in meters, and return the mesh."""
        size = float(np.ptp(mesh.vertices, axis=0).max())
        if size > LARGEST_LINK:
            hint = 'if its file is in millimeters, add scale="0.001 0.001 0.001"'
            raise self.fail(geometry, f"mesh is {size:.4g} m large", hint)
        return mesh

    def visual(self, element: etree._Element, materials: dict) -> Visual | None:
        """Return the visual geometry of a URDF element, or None if its mesh file is missing.

        A missing visual mesh only causes a warning, except for the links in `drawn`, which must have theirs.
        """
        material = element.find("material")
        color = None
        if material is not None:
            color = self.color(material) or materials.get(material.get("name"))
        geometry = self.geometry(element)
        if geometry.tag == "mesh":
            try:
                file, scale = self.mesh_file(geometry)
            except InputError as error:
                link = element.getparent()
                if link is not None and link.get("name") in self.drawn:
                    raise
                self.undrawn.append(str(error))
                return None
            return Visual(self.origin(element), file=file, scale=scale, color=color)
        return Visual(self.origin(element), shape=self.shape(element), color=color)

    def joint(self, element: etree._Element, links: dict[str, Link]) -> list[Joint]:
        """Convert a URDF joint to joints of the robot model: several joints for a planar or floating joint,
        one joint for any other type.

        Massless links connect the joints of such a chain.
        """
        name, type_ = self.attribute(element, "name"), self.attribute(element, "type")
        if type_ not in JOINT_TYPES:
            known = f"known: {', '.join(sorted(JOINT_TYPES))}"
            raise self.fail(element, f"unknown joint type {type_!r}", hint=known)
        ends = {}
        for end in ("parent", "child"):
            found = element.find(end)
            if found is None:
                raise self.fail(element, f"has no <{end}>")
            ends[end] = self.attribute(found, "link")
            if ends[end] not in links:
                raise self.fail(element, f"{end} link {ends[end]!r} does not exist")
        axis_element = element.find("axis")
        axis = np.array([1.0, 0.0, 0.0])
        if axis_element is not None:
            axis = np.array(self.numbers(axis_element, "xyz", 3))
            if type_ != "fixed":
                if np.linalg.norm(axis) < 1e-9:
                    raise self.fail(axis_element, "axis has length zero")
                axis = axis / np.linalg.norm(axis)
        limits = self.limits(element, type_)
        mimic_element = element.find("mimic")
        mimic = None
        if mimic_element is not None and type_ != "fixed":  # a fixed joint cannot mimic another joint
            mimic = Mimic(
                self.attribute(mimic_element, "joint"),
                self.number(mimic_element, "multiplier", 1.0),
                self.number(mimic_element, "offset", 0.0),
            )
        dynamics = element.find("dynamics")
        whole = Joint(
            name=name,
            type=type_,
            parent=ends["parent"],
            child=ends["child"],
            T_parent_joint=self.origin(element),
            axis=tuple(axis.tolist()),
            limits=limits,
            mimic=mimic,
            damping=0.0 if dynamics is None else self.number(dynamics, "damping", 0.0),
            friction=0.0 if dynamics is None else self.number(dynamics, "friction", 0.0),
        )
        return single_joints(whole, links)

    def limits(self, element: etree._Element, type_: str) -> JointLimits:
        limit = element.find("limit")
        if limit is None:
            if type_ in ("revolute", "prismatic"):
                raise self.fail(
                    element,
                    f"a {type_} joint needs <limit>",
                    hint="add <limit lower= upper= effort= velocity=>",
                )
            return JointLimits()
        bounded = type_ in ("revolute", "prismatic")
        lower = self.number(limit, "lower", 0.0) if bounded else -np.inf
        upper = self.number(limit, "upper", 0.0) if bounded else np.inf
        if lower > upper:
            raise self.fail(limit, f"lower {lower:g} is above upper {upper:g}")
        for text in limit_faults(str(element.get("name")), type_, lower, upper):
            self.report(limit, "%s", text)
        positive = lambda v: v if v > 0 else np.inf  # noqa: E731  (0 means "no limit" in many files)
        return JointLimits(
            lower,
            upper,
            velocity=positive(self.number(limit, "velocity", 0.0)),
            effort=positive(self.number(limit, "effort", 0.0)),
        )

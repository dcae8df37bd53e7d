"""Recognition of suction cups: center, axis, radius and lip of each cup, measured on the links' shapes.

A cup is a circle at the outer end of a link. One link may have several cups. The names of the links only
suggest cups; setup measures them if the user states that the gripper holds by suction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, Cone, Cylinder, InputError, Mesh, Shape
from armcell.model.assets import load_mesh
from armcell.model.composition import with_frame
from armcell.model.grippers import MAX_STROKE, SuctionCup, SuctionGripper
from armcell.model.robot import EndEffector, Link, RobotModel
from armcell.model.setup.arm_detection import cup_links
from armcell.model.setup.hand_geometry import GripperNotRecognizedError

F64 = NDArray[np.float64]

STROKE = 0.002  # [m] lip beyond the ring, of a cup whose shape does not tell it
RIM = 5e-4  # [m] depth of the outer end in which the rim of a cup is
ROUND = 0.06  # largest relative deviation of a rim from a circle; a regular octagon has 0.04
RADII = (0.002, 0.1)  # [m] smaller circles are screw holes, larger ones are not cups
PARALLEL = 0.996  # cosine of 5 degrees, largest angle between the axes of two cups
LEVEL = 0.001  # [m] largest distance of a ring from the plane of all rings
SAME = 1e-4  # [m] an existing tool frame that is this close to the cups' center is the tcp
_DIRECTIONS = 16
_SECTIONS = 48


@dataclass(frozen=True, eq=False)
class MeasuredCup:
    """Suction cup measured on the shape of a link: its lip ends at the center of the link's outer circle.

    Attributes:
        center: (3,) center of the circle at the lip's free end, in the frame of the link [m].
        axis: (3,) unit vector out of the cup, in the frame of the link.
        radius: inner radius of the lip if the shape is hollow, else its outer radius [m].
        depth: depth of the hollow [m], infinite for a shape without one.
    """

    link: str
    center: F64
    axis: F64
    radius: float
    depth: float

    @property
    def stroke(self) -> float:
        """Return how far the free lip of a suction cup reaches beyond the ring [m]: at most the depth of the
        cup's hollow.
        """
        return round(min(STROKE, self.depth, MAX_STROKE), 5)


def with_suction_gripper(
    model: RobotModel, end: EndEffector, links: Sequence[str] = (), tool: str = ""
) -> RobotModel:
    """Add a suction gripper to the robot and return the robot. The cups are measured on the shapes of their
    links.

    Args:
        links: links of the cups; empty: the links that are named like cups.
        tool: link that must be the tcp, in the middle of the rings; empty: a suitable frame, or a new link.
    Raises:
        GripperNotRecognizedError: a link has no circle at its outer end, or the cups do not point in one
            direction from one plane.
    """
    group = model.groups[end.group].link_names
    chosen = tuple(links) or cup_links(model, group)
    if not chosen:
        raise GripperNotRecognizedError(
            f"none of its links is named like a suction cup ({', '.join(group)})",
            "pass --gripper cups=LINK,LINK with the links of the cups",
        )
    mount = end.parent_link
    for name in chosen:
        if name not in _rigid(model, mount):
            raise GripperNotRecognizedError(f"cup {name} is not fixed to {mount}, the link that carries it")
    cups = [cup for name in chosen for cup in measured_cups(model, mount, name)]
    Ts = [model.pose_at_zero(mount, c.link) for c in cups]
    axes = np.array([T.rotation.matrix @ c.axis for T, c in zip(Ts, cups)])
    if (axes @ axes[0]).min() < PARALLEL:
        raise GripperNotRecognizedError("its suction cups do not point in one direction")
    z = axes.mean(0) / np.linalg.norm(axes.mean(0))
    rings = np.array([T.apply(c.center - c.stroke * c.axis) for T, c in zip(Ts, cups)])
    if np.abs(rings @ z - (rings @ z).mean()).max() > LEVEL:
        low, high = 1000 * (rings @ z).min(), 1000 * (rings @ z).max()
        raise GripperNotRecognizedError(
            f"its suction cups do not end in one plane: their rings are {high - low:.0f} mm apart along z"
        )
    T_mount_tcp = SE3(SO3(_axes(z, rings)), rings.mean(0))
    model, tcp = _with_tcp(model, end, T_mount_tcp, tool)
    body = [n for n in group if model.links[n].collisions]
    gripper = SuctionGripper(
        name=end.name,
        arm_group=str(end.parent_group),
        group=end.group,
        tcp_link=tcp,
        hand_links=tuple(dict.fromkeys([*body, *chosen])),
        cups=tuple(_cup(c) for c in cups),
    )
    return replace(model, grippers={**model.grippers, end.name: gripper})


def measured_cups(model: RobotModel, mount: str, name: str) -> list[MeasuredCup]:
    """Measure the suction cups at the outer end of a link that is fixed to the link `mount`.

    Raises:
        GripperNotRecognizedError: the link has no circle at its outer end.
    """
    link, T_link_mount = model.links[name], model.pose_at_zero(mount, name).inverse()
    for shapes in (_collisions(link), _visuals(link)):
        if not shapes:
            continue
        points = np.concatenate([T.apply(mesh.vertices) for mesh, T in shapes])
        out = (points.min(0) + points.max(0)) / 2 - T_link_mount.translation
        axes = np.concatenate([np.eye(3), *(T.rotation.matrix.T for _, T in shapes)])
        axes = np.concatenate([axes, -axes])
        for axis in sorted(axes, key=lambda a: -float(a @ out)):
            if axis @ out > 1e-6 and (found := _rims(name, shapes, axis)):
                return found
    raise GripperNotRecognizedError(
        f"link {name} has no circle of {1000 * RADII[0]:.0f} to {1000 * RADII[1]:.0f} mm radius at its outer "
        "end, so it is not a suction cup",
        "pass --gripper cups=LINK,LINK, or describe the cups in robot.yaml (docs/adding_a_gripper.md)",
    )


def _rims(name: str, shapes: list[tuple[Mesh, SE3]], axis: F64) -> list[MeasuredCup]:
    """Find the rims of suction cups: return the circles at the end of a link's shapes along an axis, the
    largest of concentric circles.
    """
    found: list[MeasuredCup] = []
    u = np.asarray(np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))]), dtype=float)
    u /= np.linalg.norm(u)
    w = np.asarray(np.cross(axis, u), dtype=float)
    end = max(float((T.apply(mesh.vertices) @ axis).max()) for mesh, T in shapes)
    for mesh, T in shapes:
        points = T.apply(mesh.vertices)
        height = points @ axis
        flat = points @ np.stack([u, w], axis=1)
        for at in _connected(mesh, height > end - RIM):
            rim = flat[at]
            circle = _circle(rim)
            if circle is None:
                continue
            center, outer = circle
            inner = float(np.linalg.norm(rim - center, axis=1).min())
            core = height[np.linalg.norm(flat - center, axis=1) < outer / 2]
            depth = end - float(core.max(initial=-np.inf))
            radius = inner if inner > outer / 2 else outer
            middle = center[0] * u + center[1] * w + end * axis
            found.append(MeasuredCup(name, middle, axis, radius, depth if depth > RIM else np.inf))
    found.sort(key=lambda c: -c.radius)
    kept: list[MeasuredCup] = []
    for cup in found:
        if all(np.linalg.norm(cup.center - k.center) > k.radius for k in kept):
            kept.append(cup)
    return sorted(kept, key=lambda c: tuple(np.round(c.center, 6)))


def _connected(mesh: Mesh, at: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """Group the vertices that the mask `at` (v,) selects, such as those of suction cups' rims, into parts
    that edges connect. Return one index array for each part.
    """
    from scipy.sparse import coo_matrix  # imported late: the import takes 0.1 s, and few models have cups
    from scipy.sparse.csgraph import connected_components

    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    edges = edges[at[edges].all(1)]
    size = len(mesh.vertices)
    graph = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    used = np.flatnonzero(at)
    return [used[label[used] == k] for k in np.unique(label[used])]


def _circle(points: F64) -> tuple[F64, float] | None:
    """Fit a circle to the rim points (n, 2) of a suction cup. Return its center (2,) and radius [m], or None
    if the points are not on a circle.
    """
    angle = np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    high, low = (points @ along.T).max(0), (points @ along.T).min(0)
    center = np.linalg.lstsq(along, (high + low) / 2, rcond=None)[0]
    reach = np.concatenate([high - along @ center, along @ center - low])
    radius = float(reach.mean())
    if not RADII[0] <= radius <= RADII[1] or np.abs(reach - radius).max() > ROUND * radius:
        return None
    return center, radius


def _collisions(link: Link) -> list[tuple[Mesh, SE3]]:
    return [(mesh, c.T_link_shape) for c in link.collisions if (mesh := _mesh(c.shape)) is not None]


def _visuals(link: Link) -> list[tuple[Mesh, SE3]]:
    found = []
    for visual in link.visuals:
        try:
            mesh = load_mesh(visual.file, visual.scale) if visual.file else _mesh(visual.shape)
        except InputError:
            continue
        if mesh is not None:
            found.append((mesh, visual.T_link_visual))
    return found


def _mesh(shape: Shape | None) -> Mesh | None:
    """Return the mesh of a shape that can be a suction cup: a mesh, a cylinder or a cone. Return None for any
    other shape.
    """
    if isinstance(shape, Mesh):
        return shape
    if not isinstance(shape, Cylinder | Cone):
        return None
    angle = 2 * np.pi * np.arange(_SECTIONS) / _SECTIONS
    ring = np.column_stack([shape.radius * np.cos(angle), shape.radius * np.sin(angle)])
    i, j = np.arange(_SECTIONS), (np.arange(_SECTIONS) + 1) % _SECTIONS
    bottom = np.column_stack([ring, np.full(_SECTIONS, -shape.length / 2)])
    top = np.column_stack([(isinstance(shape, Cylinder)) * ring, np.full(_SECTIONS, shape.length / 2)])
    side = np.concatenate(
        [np.column_stack([i, j, i + _SECTIONS]), np.column_stack([j, j + _SECTIONS, i + _SECTIONS])]
    )
    return Mesh(np.concatenate([bottom, top]), side.astype(np.int32))


def _cup(cup: MeasuredCup) -> SuctionCup:
    """Return the entry of a measured suction cup in a gripper's description. The cup's frame is at its
    rigid ring, behind the flexible lip.
    """
    x = np.eye(3)[np.argmin(np.abs(cup.axis))]
    y = np.asarray(np.cross(cup.axis, x), dtype=float)
    y /= np.linalg.norm(y)
    R = SO3(np.stack([np.asarray(np.cross(y, cup.axis), dtype=float), y, cup.axis], axis=1))
    ring = cup.center - cup.stroke * cup.axis
    xyz, rpy = (tuple(round(float(v), 6) + 0.0 for v in values) for values in (ring, R.rpy))
    return SuctionCup(link=cup.link, radius=round(cup.radius, 5), stroke=cup.stroke, xyz=xyz, rpy=rpy)


def _axes(z: F64, rings: F64) -> F64:
    """Return the axes (3, 3) of a suction gripper's tcp as columns: y along the line between the two cups
    that are farthest apart.
    """
    if len(rings) > 1:
        apart = np.linalg.norm(rings[:, None] - rings[None], axis=2)
        a, b = np.unravel_index(np.argmax(apart), apart.shape)
        y = rings[b] - rings[a]
    else:
        y = np.eye(3)[1] if abs(z[1]) < 0.9 else np.eye(3)[2]
    y = y - (y @ z) * z
    y /= np.linalg.norm(y)
    y = y if y[np.argmax(np.abs(y))] > 0 else -y
    return np.stack([np.asarray(np.cross(y, z), dtype=float), y, z], axis=1)


def _with_tcp(model: RobotModel, end: EndEffector, T_mount_tcp: SE3, tool: str) -> tuple[RobotModel, str]:
    """Return the robot with a tcp link in the middle of the suction cups' rings, and the name of the link."""
    mount = end.parent_link
    for name in (tool,) if tool else _rigid(model, mount):
        if model.links[name].collisions and not tool:
            continue
        T = model.pose_at_zero(mount, name).inverse() @ T_mount_tcp if name in _rigid(model, mount) else None
        if T is not None and np.linalg.norm(T.translation) < SAME and T.rotation.matrix[2, 2] > PARALLEL:
            return model, name
        if tool:
            at = "not fixed to the hand" if T is None else "at another place or has another z axis"
            raise GripperNotRecognizedError(
                f"tcp {tool} is not in the middle of the cups' rings with z out of the cups: it is {at}",
                "omit tcp=; setup adds a link there",
            )
    name = f"{end.name}_tcp"
    return with_frame(model, name, mount, T_mount_tcp), name


def _rigid(model: RobotModel, link: str) -> list[str]:
    """Return the links that fixed joints connect to a link, from the link outward; these links can carry
    suction cups.
    """
    return [n for n in model.subtree(link) if all(not j.movable for j in model.chain(link, n))]

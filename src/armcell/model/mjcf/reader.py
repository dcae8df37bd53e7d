"""Conversion of MJCF files to robot models with links, joints, shapes, servos and keyframes."""

from __future__ import annotations

import logging
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell._array_store import key_of, recall_or_compute
from armcell.core import SE3, SO3, Box, Capsule, Cylinder, InputError, Mesh, Shape, Sphere
from armcell.model.assets import MESH_SUFFIXES
from armcell.model.mjcf.coupling import ON_JOINT, ON_TENDON, Couplings, couplings, tendon_joints
from armcell.model.mjcf.files import MjcfText, read_mjcf
from armcell.model.mjcf.spec import RobotSpec, joints_of, robot_spec
from armcell.model.robot import (
    Collision,
    Inertial,
    Joint,
    JointLimits,
    Link,
    Mimic,
    MjcfPart,
    RobotModel,
    Servo,
    Visual,
)
from armcell.model.units import limit_faults

logger = logging.getLogger(__name__)

GEOM = mujoco.mjtGeom
MESHES = int(GEOM.mjGEOM_MESH), int(GEOM.mjGEOM_SDF)
DRAWN_GROUPS = (0, 1, 2)  # geom groups that MuJoCo's viewers show by default
_ELLIPSOID_DETAIL = 3  # subdivisions of the icosphere that an ellipsoid becomes


def load_mjcf(path: Path) -> RobotModel:
    """Read a robot from an MJCF file. The result has no planning groups.

    Bodies become links, hinges and slides joints, and named sites links without geometry. Joints that
    equalities, tendons or closed linkages couple become mimic joints. If the model has several base bodies or
    a base with a pose, the root link is the MJCF's world frame, named after the model.

    Raises:
        InputError: the file is missing or invalid, MuJoCo rejects it, or it describes no robot.
    """
    return parse_mjcf(read_mjcf(Path(path)))


def parse_mjcf(source: MjcfText) -> RobotModel:
    """Convert the text of an MJCF file to a robot. See `load_mjcf`.

    Raises:
        InputError: MuJoCo rejects the text, or it describes no robot.
    """
    path = source.file
    try:
        found = robot_spec(source.text)
        return _Reader(path, source, found).robot()
    except ValueError as error:
        raise source.failed(str(error)) from None
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(error.reason, file=path, hint=error.hint) from None


def _convex_hull(vertices: NDArray[np.float64]) -> Mesh:
    """Return the convex hull of a mesh's vertices (v, 3) [m]. It is cached on disk."""

    def computed() -> dict[str, NDArray]:
        import trimesh  # imported late: the import takes 0.5 s, which only new meshes need

        hull = trimesh.convex.convex_hull(vertices)
        return {"vertices": np.array(hull.vertices), "faces": np.array(hull.faces, dtype=np.int32)}

    stored = recall_or_compute("meshes", key_of("hull", version("trimesh"), vertices), computed)
    return Mesh(stored["vertices"], stored["faces"])


class _Reader:
    def __init__(self, file: Path, source: MjcfText, found: RobotSpec):
        self.file, self.source, self.found = file, source, found
        self.m: Any = found.compiled
        self.name = found.spec.modelname or file.stem
        self.couplings: Couplings = couplings(self.m, self.name)
        self.sprung = self.sprung_joints()

    def robot(self) -> RobotModel:
        m = self.m
        if not len(m.jnt_type):
            raise InputError(
                "has no joint that moves", file=self.file, hint="give a model with hinges or slides"
            )
        links: dict[str, Link] = {}
        joints: dict[str, Joint] = {}
        root = self.root()
        links[root] = Link(root)
        self.below(0, root, links, joints)
        if self.found.objects:
            logger.warning(
                "%s: left out objects that move freely: %s (put them into the cell's 'objects')",
                self.file, ", ".join(self.found.objects),
            )  # fmt: skip
        self.report_undriven()
        known = {n: {j: q for j, q in key.items() if joints[j].movable} for n, key in self.found.keys.items()}
        part = MjcfPart(self.source.text, root, frozenset(links), "", known)
        model = RobotModel(
            self.name,
            root,
            links,
            joints,
            disabled_collisions=self.disabled(),
            source=str(self.file),
            mjcf=(part,),
        )
        self.report_bare(model)
        return model

    def report_bare(self, model: RobotModel) -> None:
        """Warn about visible links of an MJCF file that planning and physics do not check for collisions."""
        groups = [g for g in model.rigid_groups if any(model.links[name].collisions for name in g)]
        solid = {name for group in groups for name in group}
        bare = [name for name, link in model.links.items() if link.visuals and name not in solid]
        if bare:
            logger.warning(
                "%s: links without collision geometry: %s (armcell does not check them for collisions: their "
                "geoms have contype 0 and conaffinity 0)",
                self.file, ", ".join(bare),
            )  # fmt: skip

    def disabled(self) -> dict[frozenset[str], str]:
        """Read from an MJCF file the link pairs without collision checks: adjacent bodies,
        and pairs that the file excludes.

        Contact masks do not count: a model whose links never touch each other in MuJoCo may still collide.
        """
        m = self.m
        pairs = [("Adjacent", b, int(m.body_parentid[b])) for b in range(1, m.nbody) if m.body_parentid[b]]
        pairs += [("User", int(s) >> 16, int(s) & 0xFFFF) for s in m.exclude_signature]
        return {frozenset((m.body(a).name, m.body(b).name)): why for why, a, b in pairs if a and b and a != b}

    def root(self) -> str:
        """Return the name of the root link of a robot model that is read from an MJCF file.

        If the robot has a single base body and this body is fixed at the origin, the body is the root link.
        Otherwise, return an unused name for a new root link.
        """
        m = self.m
        bases = [b for b in range(1, m.nbody) if m.body_parentid[b] == 0]
        if len(bases) == 1 and not m.body_jntnum[bases[0]]:
            T = self.pose(m.body_pos, m.body_quat, bases[0])
            if T.isclose(SE3.identity()):
                return m.body(bases[0]).name
        taken = {m.body(i).name for i in range(m.nbody)} | set(self.found.frames.values())
        name = f"{self.name}_world"
        while name in taken:
            name += "_"
        return name

    @staticmethod
    def pose(positions: Any, quats: Any, i: int) -> SE3:
        return SE3(SO3.from_quat_wxyz(quats[i]), np.array(positions[i], dtype=float))

    def below(self, body: int, link: str, links: dict[str, Link], joints: dict[str, Joint]) -> None:
        """Convert all MJCF bodies below a given body to links and joints, depth first."""
        m = self.m
        for child in range(body + 1, m.nbody):
            if m.body_parentid[child] != body:
                continue
            name = m.body(child).name
            if name == next(iter(links)):
                links[name] = self.link(child)
            else:
                self.chain(child, link, links, joints)
            for i in range(m.nsite):
                if int(m.site_bodyid[i]) == child and m.site(i).name:
                    site = self.found.sites[m.site(i).name]
                    links[site] = Link(site)
                    self.fix(joints, name, site, self.pose(m.site_pos, m.site_quat, i))
            self.below(child, name, links, joints)

    @staticmethod
    def fix(joints: dict[str, Joint], parent: str, child: str, T: SE3) -> None:
        joint = f"{parent}_to_{child}"
        while joint in joints:
            joint += "_"
        joints[joint] = Joint(joint, "fixed", parent, child, T)

    def chain(self, body: int, parent: str, links: dict[str, Link], joints: dict[str, Joint]) -> None:
        """Convert the joints of an MJCF body to a chain of joints and links.
        The chain ends at the link of the body.

        MuJoCo applies the joints in order, each about its anchor in the frame that the joints before it
        moved.
        """
        m, name = self.m, self.m.body(body).name
        T, anchor = self.pose(m.body_pos, m.body_quat, body), np.zeros(3)
        for i in joints_of(m, body):
            joint = m.joint(i).name
            frame = self.found.frames[joint]
            links[frame] = self.link(body) if frame == name else Link(frame)
            T_parent_joint = T @ SE3(SO3.identity(), m.jnt_pos[i] - anchor)
            joints[joint] = self.joint(i, joint, parent, frame, T_parent_joint)
            parent, anchor, T = frame, np.array(m.jnt_pos[i]), SE3.identity()
        if name not in links:
            links[name] = self.link(body)
            self.fix(joints, parent, name, T @ SE3(SO3.identity(), -anchor))

    # --- joints ---
    def joint(self, i: int, name: str, parent: str, child: str, T: SE3) -> Joint:
        m = self.m
        slides = m.jnt_type[i] == mujoco.mjtJoint.mjJNT_SLIDE
        axis = np.array(m.jnt_axis[i], dtype=float)
        ref = float(m.qpos0[m.jnt_qposadr[i]])
        if ref:  # the joint's position in the pose of the file
            T = T @ (SE3(SO3.identity(), -ref * axis) if slides else SE3(SO3.exp(-ref * axis), np.zeros(3)))
        if i in self.sprung:
            rest = float(m.qpos_spring[m.jnt_qposadr[i]])
            moved = SE3(SO3.identity(), rest * axis) if slides else SE3(SO3.exp(rest * axis), np.zeros(3))
            return Joint(name, "fixed", parent, child, T @ moved)
        limited = bool(m.jnt_limited[i])
        low, high = (float(v) for v in m.jnt_range[i]) if limited else (-np.inf, np.inf)
        for text in limit_faults(name, "prismatic" if slides else "revolute", low, high):
            logger.warning("%s: %s", self.file, text)
        rule = self.couplings.rules.get(i)
        servo, effort = self.servo(i)
        dof = int(m.jnt_dofadr[i])
        return Joint(
            name,
            "prismatic" if slides else "revolute" if limited else "continuous",
            parent,
            child,
            T,
            (float(axis[0]), float(axis[1]), float(axis[2])),
            JointLimits(low, high, effort=effort),
            None if rule is None else Mimic(m.joint(rule[0]).name, rule[1], rule[2]),
            damping=float(np.ravel(m.dof_damping[dof])[0]),
            friction=float(m.dof_frictionloss[dof]),
            servo=servo,
        )

    def servo(self, joint: int) -> tuple[Servo | None, float]:
        """Return the position servo of an MJCF joint, read from its actuator,
        and the joint's maximum effort. The servo may be None.

        An actuator with gear g and gain k on the length g q acts on the joint as a servo of gain g^2 k.
        """
        m = self.m
        limits = [float(np.abs(m.jnt_actfrcrange[joint]).max())] if m.jnt_actfrclimited[joint] else []
        found = None
        for i in range(len(m.actuator_trntype)):
            gear = self.gear(i, joint)
            if gear == 0.0:
                continue
            fixed = m.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_FIXED
            motor = fixed and m.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_NONE
            if m.actuator_forcelimited[i]:
                limits.append(float(abs(gear) * np.abs(m.actuator_forcerange[i]).max()))
            elif motor and m.actuator_ctrllimited[i]:
                most = np.abs(m.actuator_ctrlrange[i]).max() * abs(m.actuator_gainprm[i, 0])
                limits.append(float(abs(gear) * most))
            bias = m.actuator_biasprm[i]
            if m.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_AFFINE and bias[1] < 0:
                found = Servo(float(-bias[1] * gear**2), max(-float(bias[2]), 0.0) * gear**2)
        return found, min((v for v in limits if v > 0), default=np.inf)

    def gear(self, actuator: int, joint: int) -> float:
        """Return how much the length of an MJCF actuator changes per unit of a joint's motion. It is 0 if the
        actuator drives another joint.
        """
        m = self.m
        kind, target = int(m.actuator_trntype[actuator]), int(m.actuator_trnid[actuator, 0])
        gear = float(m.actuator_gear[actuator, 0])
        if kind in ON_JOINT:
            return gear if target == joint else 0.0
        if kind != ON_TENDON:
            return 0.0
        total = 0.0
        for j, coefficient in tendon_joints(m, target):
            driver, multiplier, _ = self.couplings.rules.get(j, (j, 1.0, 0.0))
            total += coefficient * multiplier if driver == joint else 0.0
        return gear * total

    def sprung_joints(self) -> set[int]:
        """Return the joints in an MJCF file that only springs hold in position, such as those of soft
        fingertips.

        They rest at their springs' reference positions, because no motor moves them. Physics keeps them.
        Hands with spatial tendons have return springs in joints that the tendons move.
        """
        m, known = self.m, self.couplings.actuated | set(self.couplings.rules)
        moved = [(int(kind), int(m.actuator_trnid[i, 0])) for i, kind in enumerate(m.actuator_trntype)]
        if not moved or not all(k in ON_JOINT or (k == ON_TENDON and tendon_joints(m, t)) for k, t in moved):
            return set()
        return {i for i in range(m.njnt) if i not in known and np.ravel(m.jnt_stiffness[i])[0] > 0}

    def report_undriven(self) -> None:
        m = self.m
        known = self.couplings.actuated | set(self.couplings.rules) | self.sprung
        loose = [m.joint(i).name for i in range(m.njnt) if i not in known]
        if loose and len(m.actuator_trntype):
            logger.warning(
                "%s: joints without an actuator: %s (armcell plans for them and drives them with its own "
                "servos; couple them by an <equality> if they are passive)",
                self.file, ", ".join(loose),
            )  # fmt: skip

    # --- links ---
    def link(self, body: int) -> Link:
        m = self.m
        first, count = int(m.body_geomadr[body]), int(m.body_geomnum[body])
        geoms = range(first, first + count) if first >= 0 else range(0)
        pairs = {int(i) for ids in (m.pair_geom1, m.pair_geom2) for i in ids}
        solid = [g for g in geoms if m.geom_contype[g] or m.geom_conaffinity[g] or g in pairs]
        shown = [g for g in geoms if int(m.geom_group[g]) in DRAWN_GROUPS]
        return Link(
            m.body(body).name,
            self.inertial(body),
            tuple(c for g in solid if (c := self.collision(g)) is not None),
            tuple(v for g in shown if (v := self.visual(g)) is not None),
        )

    def inertial(self, body: int) -> Inertial | None:
        m = self.m
        if m.body_mass[body] <= 0:
            return None
        T = self.pose(m.body_ipos, m.body_iquat, body)
        return Inertial(float(m.body_mass[body]), T, np.diag(m.body_inertia[body]))

    def collision(self, geom: int) -> Collision | None:
        """Read an MJCF geom and convert it to a collision shape. A mesh is replaced by its convex hull.

        MuJoCo uses the hull as well.
        """
        shape = self.primitive(geom)
        if shape is None and (mesh := self.mesh(geom)) is not None:
            shape = _convex_hull(mesh[0])
        return None if shape is None else Collision(shape, self.geom_pose(geom))

    def visual(self, geom: int) -> Visual | None:
        m = self.m
        material = int(m.geom_matid[geom])
        r, g, b, a = (float(v) for v in (m.mat_rgba[material] if material >= 0 else m.geom_rgba[geom]))
        if a <= 0:
            return None
        shape, T = self.primitive(geom), self.geom_pose(geom)
        if shape is not None:
            return Visual(T, shape=shape, color=(r, g, b, a))
        mesh = self.mesh(geom)
        if mesh is None:
            return None
        i = int(m.geom_dataid[geom])
        asset = self.found.spec.mesh(m.mesh(i).name)
        moved = np.any(np.array(asset.refpos) != 0) or np.any(np.array(asset.refquat) != (1, 0, 0, 0))
        if asset.file and not moved and Path(asset.file).suffix.lower() in MESH_SUFFIXES:
            T_file = self.pose(m.mesh_pos, m.mesh_quat, i)  # MuJoCo moves meshes to their principal axes
            sx, sy, sz = (float(v) for v in asset.scale)
            return Visual(T @ T_file.inverse(), file=Path(asset.file), scale=(sx, sy, sz), color=(r, g, b, a))
        return Visual(T, shape=Mesh(*mesh), color=(r, g, b, a))

    def geom_pose(self, geom: int) -> SE3:
        return self.pose(self.m.geom_pos, self.m.geom_quat, geom)

    def primitive(self, geom: int) -> Shape | None:
        a, b, c = (float(v) for v in self.m.geom_size[geom])
        match self.m.geom_type[geom]:
            case GEOM.mjGEOM_SPHERE:
                return Sphere(a)
            case GEOM.mjGEOM_BOX:
                return Box(2 * a, 2 * b, 2 * c)
            case GEOM.mjGEOM_CYLINDER:
                return Cylinder(a, 2 * b)
            case GEOM.mjGEOM_CAPSULE:
                return Capsule(a, 2 * b)
        return None

    def mesh(self, geom: int) -> tuple[NDArray[np.float64], NDArray[np.int32]] | None:
        """Read the vertices (v, 3) [m, geom frame] and faces (f, 3) of an MJCF geom that is a mesh or an
        ellipsoid.
        """
        m = self.m
        if m.geom_type[geom] == GEOM.mjGEOM_ELLIPSOID:
            import trimesh

            ball = trimesh.creation.icosphere(_ELLIPSOID_DETAIL)
            return np.array(ball.vertices) * m.geom_size[geom], np.array(ball.faces, dtype=np.int32)
        i = int(m.geom_dataid[geom])
        if int(m.geom_type[geom]) not in MESHES or i < 0:
            return None
        v, f = int(m.mesh_vertadr[i]), int(m.mesh_faceadr[i])
        vertices = np.array(m.mesh_vert[v : v + int(m.mesh_vertnum[i])], dtype=float)
        return vertices, np.array(m.mesh_face[f : f + int(m.mesh_facenum[i])], dtype=np.int32)

"""The robot in a MuJoCo model: bodies, joints, geoms, actuators, and attachment of its MJCF parts."""

from __future__ import annotations

from itertools import combinations, product
from typing import Any

import mujoco
import numpy as np

from armcell.core import SE3, SO3, Mesh
from armcell.kinematics import kinematic_tree
from armcell.model import Gripper, Joint, Link, RobotModel
from armcell.model.assets import DEFAULT_COLOR, visual_parts
from armcell.model.composition import finger_parts
from armcell.model.mjcf.spec import physics_spec
from armcell.model.robot import SERVO_ERROR, MjcfPart
from armcell.scene import WORLD, PlanningScene
from armcell.sim.joint_gains import arm_joints, check_joint_gains
from armcell.sim.objects import (
    COLLISION_GROUP,
    OBJECT_GROUP,
    VISUAL_GROUP,
    GeomAdder,
    full_inertia,
)
from armcell.sim.settings import PhysicsSettings, effective_gains

EXCLUDED = 1e-3  # [rad or m] by which a mimic joint's limits may miss the range of its coupling
FINGER_INERTIA = 2.0  # [kg] largest armature of a hand's joint, as mass at the pads (Menagerie's 2F-85: 1.5)


def mjcf_links(model: RobotModel) -> dict[str, MjcfPart]:
    """Return, for each link of a simulated robot that comes from an MJCF file, the MJCF part from which the
    link is built.
    """
    return {link: part for part in model.mjcf for link in part.links if link in model.links}


def attach_part(spec: Any, parent: Any, model: RobotModel, link: str, T_parent_link: SE3) -> dict[str, Any]:
    """Attach the bodies of a robot's MJCF part to the MuJoCo spec of the simulation, starting at a given
    link. Return the attached bodies by link.

    The bodies keep their inertias, contact parameters, joint parameters, equalities, tendons and excludes;
    names get the part's prefix.

    Args:
        spec: the MjSpec of the physics model.
        parent: its body that carries the link.
        T_parent_link: pose of the link, with its joint at zero.
    """
    part = mjcf_links(model)[link]
    child = physics_spec(part.text).copy()
    child.option, child.visual, child.stat = spec.option, spec.visual, spec.stat  # the cell's settings apply
    names = {body.name for body in child.bodies}
    own = link.removeprefix(part.prefix)
    pose = {"pos": T_parent_link.translation, "quat": T_parent_link.quat_wxyz}
    if own in names:
        body = child.body(own)
        # The body's own pose relative to its parent is part of T_parent_link.
        body.pos, body.quat = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
        body.alt.type = 0
        for joint in list(body.joints):
            child.delete(joint)
        parent.add_frame(**pose).attach_body(body, part.prefix, "")
        return {name: spec.body(name) for name in model.subtree(link) if name in part.links}
    root = parent.add_body(name=link, **pose)  # the frame of the MJCF's world
    spec.attach(child, prefix=part.prefix, frame=root.add_frame())
    return {name: root if name == link else spec.body(name) for name in part.links if name in model.links}


_TINY_MASS, _TINY_INERTIA = 1e-4, 1e-7


def add_robot(
    spec: mujoco.MjSpec, adder: GeomAdder, model: RobotModel, settings: PhysicsSettings, visuals: bool
) -> dict[str, Any]:
    bodies: dict[str, Any] = {}
    from_mjcf = mjcf_links(model)
    scales = _finger_scales(model)
    # a composed model of several robots has the root link "world", which is MuJoCo's world body
    if model.root_link == WORLD:
        bodies[WORLD] = spec.worldbody
    elif model.root_link not in from_mjcf:
        bodies[model.root_link] = spec.worldbody.add_body(name=model.root_link)
    else:
        bodies |= attach_part(spec, spec.worldbody, model, model.root_link, SE3.identity())
    for joint in model.joints.values():
        T = joint.T_parent_joint
        if joint.child in bodies:
            continue  # attached with its MJCF part
        if joint.child in from_mjcf:
            bodies |= attach_part(spec, bodies[joint.parent], model, joint.child, T)
            continue
        body = bodies[joint.parent].add_body(name=joint.child, pos=T.translation, quat=T.quat_wxyz)
        bodies[joint.child] = body
        if joint.movable:
            _add_joint(body, model, joint, settings, scales.get(joint.name, 1.0))
    massless = _massless_carriers(model)
    for name, body in bodies.items():
        link = model.links[name]
        if name != WORLD:
            body.gravcomp = settings.gravity_compensation  # real arms compensate their own weight
        if name in from_mjcf:
            _group_geoms(body, link)
        else:
            if name != WORLD:
                _set_inertia(body, link, name in massless)
            _add_solids(adder, body, link)
        if visuals:
            _add_visuals(adder, body, link)
    for joint in model.joints.values():
        if joint.mimic is not None and joint.child not in from_mjcf:  # MJCF parts keep their own equalities
            spec.add_equality(
                name=f"{joint.name}:mimic",
                type=mujoco.mjtEq.mjEQ_JOINT,
                name1=joint.name,
                name2=joint.mimic.joint,
                data=[joint.mimic.offset, joint.mimic.multiplier] + [0.0] * 10,
                solref=settings.object_solref,
                solimp=settings.object_solimp,
            )
    return bodies


def _finger_scales(model: RobotModel) -> dict[str, float]:
    """Return for each rotating gripper joint of a simulated robot, by name, how far [m] its finger moves per
    radian.
    """
    return {
        name: gripper.finger_travel_per_joint
        for gripper in model.grippers.values()
        for name, _ in finger_weights(model, gripper.joint_name)
        if gripper.joint_name and model.joints[name].type != "prismatic"
    }


def _is_limited(model: RobotModel, joint: Joint) -> bool:
    """Return whether a joint of a simulated robot stops at its limits.

    A mimic joint whose limits exclude positions to which its coupling moves it has no limits in physics: they
    would block the driven joint. Descriptions contain such limits (the grippers of the PR2: range 0 to 0.548
    with the multiplier -1).
    """
    low, high = joint.limits.lower, joint.limits.upper
    if not (np.isfinite(low) and np.isfinite(high)):
        return False
    driven, multiplier, offset = model.coupling(joint.name)
    driver = model.joints[driven].limits
    ends = [multiplier * q + offset for q in (driver.lower, driver.upper)]
    return low - EXCLUDED <= min(ends) and max(ends) <= high + EXCLUDED


def _add_joint(
    body: Any, model: RobotModel, joint: Joint, settings: PhysicsSettings, scale: float = 1.0
) -> None:
    """Add a joint to a body in the MuJoCo spec of a simulated robot. `scale` [m/rad] adapts armature and
    damping to a rotating finger; it is 1 for other joints.
    """
    types = mujoco.mjtJoint
    limited = _is_limited(model, joint)
    body.add_joint(
        name=joint.name,
        type=types.mjJNT_SLIDE if joint.type == "prismatic" else types.mjJNT_HINGE,
        axis=joint.axis,
        limited=limited,
        range=[joint.limits.lower, joint.limits.upper] if limited else [0.0, 0.0],
        armature=settings.armature * scale**2,
        damping=[
            max(settings.joint_damping * scale**2, joint.damping),
            0.0,
            0.0,
        ],  # linear, then higher powers of speed
        frictionloss=joint.friction,
        # MuJoCo's default soft limits would let a closing finger overshoot its limit by millimeters
        solref_limit=settings.object_solref,
        solimp_limit=settings.object_solimp,
    )


def _massless_carriers(model: RobotModel) -> set[str]:
    """Return the links of the simulated robot that move without any mass: the child links of movable joints
    for which neither the link nor any link fixed to it has a mass.

    MuJoCo rejects moving bodies without mass.
    """
    found = set()
    for group in model.rigid_groups:
        heavy = any((i := model.links[n].inertial) is not None and i.mass > 0 for n in group)
        if not heavy and model.root_link not in group:
            found |= {n for n in group if model.parent_joint[n].movable}
    return found


def _set_inertia(body: Any, link: Link, carrier: bool) -> None:
    body.explicitinertial = True
    inertial = link.inertial
    if inertial is None or inertial.mass <= 0:
        if carrier:
            body.mass, body.inertia = _TINY_MASS, [_TINY_INERTIA] * 3
        else:
            body.mass, body.inertia = 0.0, [0.0] * 3
        return
    R = inertial.T_link_com.rotation.matrix
    inertia = R @ inertial.inertia @ R.T
    if np.linalg.eigvalsh(inertia)[0] <= 0:  # some URDFs specify a mass but no inertia
        inertia = inertia + np.eye(3) * _TINY_INERTIA
    body.mass = inertial.mass
    body.ipos = inertial.T_link_com.translation
    body.fullinertia = full_inertia(inertia)


def _group_geoms(body: Any, link: Link) -> None:
    """Assign the geoms of a robot's MJCF body to the MuJoCo geom
    group that armcell uses for collision geoms.
    """
    for geom in body.geoms:
        geom.group = COLLISION_GROUP if link.visuals else OBJECT_GROUP


def _add_solids(adder: GeomAdder, body: Any, link: Link) -> None:
    color = next((v.color for v in link.visuals if v.color is not None), DEFAULT_COLOR)
    group = COLLISION_GROUP if link.visuals else OBJECT_GROUP
    for i, solid in enumerate(link.collisions):
        adder.add_solid(
            body, solid.shape, solid.T_link_shape, f"{link.name}:{i}", group=group, rgba=color, density=0.0
        )


def _add_visuals(adder: GeomAdder, body: Any, link: Link) -> None:
    looks = {"contype": 0, "conaffinity": 0, "group": VISUAL_GROUP, "density": 0.0}
    for i, visual in enumerate(link.visuals):
        name = f"{link.name}:visual{i}"
        rgba = visual.color or DEFAULT_COLOR
        if isinstance(visual.shape, Mesh):
            adder.add_mesh(body, visual.shape, visual.T_link_visual, name, rgba=rgba, **looks)
        elif visual.shape is not None:
            adder.add_solid(body, visual.shape, visual.T_link_visual, name, rgba=rgba, **looks)
        for k, (mesh, rgba) in enumerate(visual_parts(visual)):
            adder.add_mesh(body, mesh, visual.T_link_visual, f"{name}.{k}", rgba=rgba, **looks)


def add_excludes(spec: mujoco.MjSpec, scene: PlanningScene) -> None:
    """Exclude contacts in MuJoCo between links of the simulated robot that may touch, and between links that
    one joint connects.

    The allowed pairs come from the scene and its model. The hulls of neighboring links overlap at their
    joint, so a contact there would be meaningless.
    """
    model = scene.model
    group_of = {name: i for i, group in enumerate(model.rigid_groups) for name in group}
    joined = {frozenset((group_of[j.parent], group_of[j.child])) for j in model.joints.values() if j.movable}
    solid = [name for name, link in model.links.items() if link.collisions]
    bodies, from_mjcf = {name: [name] for name in solid}, mjcf_links(model)
    for name, finger in finger_parts(model).items():
        if finger in bodies and name not in bodies and name in from_mjcf:
            bodies[finger].append(name)  # the finger's link has its shapes, but MJCF keeps its body
    for a, b in combinations(solid, 2):
        groups = frozenset((group_of[a], group_of[b]))
        if len(groups) == 1 or groups in joined or scene.is_allowed(a, b):
            for first, second in product(bodies[a], bodies[b]):
                spec.add_exclude(name=f"{first}|{second}", bodyname1=first, bodyname2=second)


def add_arm_actuators(spec: mujoco.MjSpec, model: RobotModel, settings: PhysicsSettings) -> None:
    check_joint_gains(settings.joint_gains, model)
    for name in arm_joints(model):
        joint = model.joints[name]
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        drive = effective_gains(joint, settings)
        if settings.arm_control == "pid":
            actuator.set_to_pid(kp=drive.kp, kv=drive.kv)
        elif settings.arm_control == "position":
            actuator.set_to_position(kp=drive.kp, kv=drive.kv)
        else:
            actuator.set_to_motor()
        if np.isfinite(joint.limits.effort) and joint.limits.effort > 0:
            actuator.forcelimited = True
            actuator.forcerange = [-joint.limits.effort, joint.limits.effort]
        if joint.servo is not None:  # real controllers compensate friction: soft servos would stop early
            moved = spec.joint(name)
            moved.frictionloss = min(moved.frictionloss, SERVO_ERROR * drive.kp)


def add_gripper(spec: mujoco.MjSpec, model: RobotModel, gripper: Gripper, settings: PhysicsSettings) -> None:
    tendon = spec.add_tendon(name=tendon_name(gripper.name))
    for joint, weight in finger_weights(model, gripper.joint_name):
        tendon.wrap_joint(joint, weight)
    actuator = spec.add_actuator(
        name=tendon_name(gripper.name), target=tendon.name, trntype=mujoco.mjtTrn.mjTRN_TENDON
    )
    kp, kv = servo_gains(gripper, settings)
    actuator.set_to_position(kp=kp, kv=kv)
    limit = servo_force(gripper, settings)
    actuator.forcelimited = True
    actuator.forcerange = [-limit, limit]
    # A gripper's force is the force at its pads: its motor also overcomes the hand's friction and springs.
    for name in _hand_joints(model, gripper):
        joint, (driven, multiplier, offset) = spec.joint(name), model.coupling(name)
        if driven != gripper.joint_name:
            multiplier = offset = 0.0
        if multiplier:  # heavier fingers close slowly and bounce: MJCF hands inherit the armature of the arm
            travel = gripper.finger_travel_per_joint / multiplier
            joint.armature = min(joint.armature, FINGER_INERTIA * travel**2)
        joint.frictionloss = 0.0
        joint.damping[0] = min(joint.damping[0], kv)  # else the fingers creep to their target
        stiffness = float(np.ravel(joint.stiffness)[0])
        actuator.biasprm[0] += multiplier * stiffness * (offset - joint.springref)
        actuator.biasprm[1] += multiplier**2 * stiffness
    _turn_pad_boxes(spec, model, gripper)


def _turn_pad_boxes(spec: mujoco.MjSpec, model: RobotModel, gripper: Gripper) -> None:
    """Permute the axes of the boxes on the fingers of a simulated robot such that x is the closing direction.
    The boxes occupy the same space as before.

    Where the side of a cylinder touches the edge of a box, MuJoCo 4.0 computes two contacts with the normal
    of the first face along the edge, even if the cylinder presses on the other face (fixed in MuJoCo's commit
    bbb71a28). Its first faces are those along x.
    """
    q = model.neutral()
    q[model.joint_names.index(gripper.joint_name)] = gripper.joint_position(0.0)
    tree = kinematic_tree(model)
    y_axis = tree.link_pose(q, gripper.tcp_link).rotation.matrix[:, 1]
    parts = [name for name, finger in finger_parts(model).items() if finger in gripper.finger_links]
    for name in dict.fromkeys((*gripper.finger_links, *parts)):
        closing = tree.link_pose(q, name).rotation.matrix.T @ y_axis
        for geom in spec.body(name).geoms:
            if geom.type != mujoco.mjtGeom.mjGEOM_BOX or geom.meshname:
                continue
            R = SO3.from_quat_wxyz(geom.quat).matrix
            axis = int(np.argmax(np.abs(R.T @ closing)))
            order = [(axis + k) % 3 for k in range(3)]  # a cyclic order stays right-handed
            geom.quat, geom.size = SO3(R[:, order]).quat_wxyz, geom.size[order]


def _hand_joints(model: RobotModel, gripper: Gripper) -> list[str]:
    """Return the names of the movable joints in the gripper of a simulated robot, including the joints of the
    gripper's linkage.
    """
    arm = model.groups.get(gripper.arm_group)
    other = set(arm.joint_names) if arm is not None else set()
    links = {*gripper.hand_links, *gripper.finger_links}
    return [j.name for j in model.joints.values() if j.movable and j.child in links and j.name not in other]


def finger_weights(model: RobotModel, driven: str) -> list[tuple[str, float]]:
    """Return the finger joints of the simulated robot with their weights in the mean finger position: the
    driven joint of the gripper, and the joints that mimic it with zero offset.

    The weighted sum of their positions is the mean finger position. Equalities move the other joints.
    """
    found = [(driven, 1.0)]
    for joint in model.joints.values():
        mimic = joint.mimic
        if mimic is not None and mimic.joint == driven and mimic.multiplier != 0 and mimic.offset == 0:
            found.append((joint.name, mimic.multiplier))
    return [(name, 1.0 / (len(found) * multiplier)) for name, multiplier in found]


def servo_force(gripper: Gripper, settings: PhysicsSettings) -> float:
    """Return the force limit [N] of the actuator that a simulated robot gets for its gripper when the MuJoCo
    model is built.

    An actuator force f presses each finger with f / |width_per_joint|.
    """
    return min(
        settings.gripper_force * gripper.finger_travel_per_joint,
        gripper.max_force * abs(gripper.width_per_joint),
    )


def servo_gains(gripper: Gripper, settings: PhysicsSettings) -> tuple[float, float]:
    """Return the gains kp and kv with which the simulated robot drives its gripper: [N/m] and [N s/m] for a
    sliding driven joint, [Nm/rad] and [Nm s/rad] for a turning one.

    The settings are those of sliding fingers; a turning joint gets the gains with the same effect there.
    """
    return (
        settings.gripper_kp * gripper.finger_travel_per_joint**2,
        settings.gripper_kv * gripper.finger_travel_per_joint**2,
    )


def tendon_name(gripper: str) -> str:
    return f"{gripper}:grip"

"""A compiled MuJoCo model with its index tables for joints, bodies, and grippers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.model import Gripper, RobotModel
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim.cups import CupIndex, index_cups
from armcell.sim.objects import belt_name, slide_name, turn_name, weld_name
from armcell.sim.robot import finger_weights, servo_force, tendon_name
from armcell.sim.settings import PhysicsSettings

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class GripperIndex:
    """Indices and limits of the position servo that drives one gripper in a MuJoCo model built from a scene.

    The length of the servo's tendon is the driven joint's position, averaged over the fingers. A suction
    gripper has no servo; its `CupIndex`es hold the indices of its vacuum.
    """

    gripper: Gripper
    ctrl: int
    joints: tuple[tuple[int, float], ...]  # (index in qpos, weight); the tendon length is the weighted sum
    lower: float  # [m] of the driven joint
    upper: float
    max_speed: float  # [m/s] of the driven joint
    max_force: float  # [N] per finger
    finger_owners: NDArray[np.int64]  # (fingers,) index of each finger's or cup's link among the owners
    hand: NDArray[np.bool_]  # (owners,) True where the owner is a link of the hand
    tcp_body: int

    def length(self, qpos: Array) -> float:
        """Return the length [m] of the tendon that drives a gripper
        in a MuJoCo model, given the state `qpos`.

        MuJoCo's own tendon length is one step old after a step.
        """
        return sum(weight * float(qpos[i]) for i, weight in self.joints)


@dataclass(frozen=True, eq=False)
class BuiltModel:
    """A MuJoCo model that was built and compiled from a scene, with tables that map names to its indices.

    `owners` lists the links, then the objects.
    """

    scene: PlanningScene
    spec: mujoco.MjSpec
    mj: mujoco.MjModel
    owners: tuple[str, ...]
    owner_index: dict[str, int]
    link_count: int
    geom_owner: Ints  # (ngeom,) index in owners, -1 for none
    body: dict[str, int]  # by link or object name
    joint_qpos: dict[str, int]  # movable joints, mimic included
    joint_dof: dict[str, int]
    qpos: Ints  # (dof,) actuated joints in the model's order
    dofs: Ints  # (dof,)
    pos_ctrl: Ints  # (dof,) control index of the position (or torque) input, -1 for a gripper's joint
    vel_ctrl: Ints  # (dof,) control index of the velocity input, -1 for joints without one
    grippers: dict[str, GripperIndex]
    object_qpos: dict[str, int]  # movable objects: start of x, y, z, qw, qx, qy, qz
    belts: tuple[tuple[int, int, float], ...]  # index in qpos, in qvel, speed [m/s]
    threaded: dict[str, tuple[int, int]]  # screwed-in objects: qpos index of the slide and of the rotation
    object_dof: dict[str, int]
    objects: dict[str, CollisionObject]  # including attached objects, at their initial poses
    welds: dict[tuple[str, str], int]  # equality constraint id by (object, gripper)
    cups: tuple[CupIndex, ...]

    @property
    def moving(self) -> tuple[str, ...]:
        """Return the objects whose poses can change in a built MuJoCo model: free objects and screwed-in
        objects.
        """
        return (*self.object_qpos, *self.threaded)


def indexed(
    scene: PlanningScene,
    settings: PhysicsSettings,
    spec: mujoco.MjSpec,
    mj: mujoco.MjModel,
    objects: dict[str, CollisionObject],
) -> BuiltModel:
    model = scene.model
    owners = (*model.links, *objects)
    owner_index = {name: i for i, name in enumerate(owners)}
    body = {name: mj.body(name).id for name in owners}
    owner_of_body = np.full(mj.nbody, -1)
    for name, i in body.items():
        owner_of_body[i] = owner_index[name]
    cups = index_cups(mj, model, owner_index)
    for cup in cups:
        owner_of_body[cup.body] = cup.owner
    joints = {name: mj.joint(name) for name in model.movable_joint_names}
    joint_qpos = {name: int(j.qposadr[0]) for name, j in joints.items()}
    joint_dof = {name: int(j.dofadr[0]) for name, j in joints.items()}
    driven = {name for g in model.grippers.values() for name in g.joint_names}
    # each pid actuator has two controls, so an actuator's id differs from its control index
    first = {n: int(mj.actuator_ctrladr[mj.actuator(n).id]) for n in model.joint_names if n not in driven}
    free = {
        n: mj.joint(f"{n}:free")
        for n, o in objects.items()
        if o.thread is None and (o.movable or n in scene.attached)
    }
    return BuiltModel(
        scene=scene,
        spec=spec,
        mj=mj,
        owners=owners,
        owner_index=owner_index,
        link_count=len(model.links),
        geom_owner=owner_of_body[mj.geom_bodyid],
        body=body,
        joint_qpos=joint_qpos,
        joint_dof=joint_dof,
        qpos=_ints(joint_qpos[n] for n in model.joint_names),
        dofs=_ints(joint_dof[n] for n in model.joint_names),
        pos_ctrl=_ints(first.get(n, -1) for n in model.joint_names),
        vel_ctrl=_ints(
            first[n] + 1 if n in first and settings.arm_control == "pid" else -1 for n in model.joint_names
        ),
        grippers={
            g.name: _gripper_index(mj, model, g, settings, owner_index) for g in model.grippers.values()
        },
        object_qpos={n: int(j.qposadr[0]) for n, j in free.items()},
        belts=tuple(
            (int(j.qposadr[0]), int(j.dofadr[0]), float(np.linalg.norm(o.belt)))
            for n, o in objects.items()
            if o.belt is not None and (j := mj.joint(belt_name(n))) is not None
        ),
        threaded={
            n: (int(mj.joint(slide_name(n)).qposadr[0]), int(mj.joint(turn_name(n)).qposadr[0]))
            for n, o in objects.items()
            if o.thread is not None
        },
        object_dof={n: int(j.dofadr[0]) for n, j in free.items()},
        objects=objects,
        welds={(n, g): mj.equality(weld_name(n, g)).id for n in free for g in model.grippers},
        cups=cups,
    )


def _ints(values: Iterable[int]) -> Ints:
    return np.array(list(values), dtype=np.int64)


def _gripper_index(
    mj: mujoco.MjModel, model: RobotModel, gripper: Gripper, settings: PhysicsSettings, owners: dict[str, int]
) -> GripperIndex:
    common = {
        "gripper": gripper,
        "finger_owners": np.array([owners[n] for n in gripper.contact_links], np.int64),
        "hand": np.array([name in gripper.hand_links for name in owners]),
        "tcp_body": mj.body(gripper.tcp_link).id,
    }
    if not gripper.joint_name:
        force = gripper.max_force
        return GripperIndex(
            ctrl=-1, joints=(), lower=0.0, upper=0.0, max_speed=0.0, max_force=force, **common
        )
    limits = model.joints[gripper.joint_name].limits
    actuator = mj.actuator(tendon_name(gripper.name)).id
    return GripperIndex(
        ctrl=int(mj.actuator_ctrladr[actuator]),
        joints=tuple((int(mj.joint(n).qposadr[0]), w) for n, w in finger_weights(model, gripper.joint_name)),
        lower=limits.lower,
        upper=limits.upper,
        max_speed=min(limits.velocity, settings.finger_speed / gripper.finger_travel_per_joint),
        max_force=servo_force(gripper, settings) / abs(gripper.width_per_joint),
        **common,
    )

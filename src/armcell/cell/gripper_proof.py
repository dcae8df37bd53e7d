"""Proof of a gripper: the hand alone closes on a cube in physics, lifts and shakes it.

Suction cups are proven on a plate that they cover.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from armcell.core import SE3, Box, InputError
from armcell.grasping import LIFT_ACCELERATION, hand_of
from armcell.model import Gripper, RobotModel, SuctionGripper
from armcell.scene import CollisionObject

SHARE = 0.45  # edge of the cube, as a share of the widest opening
LARGEST = 0.05  # [m] edge of the cube
DENSITY = 600.0  # [kg/m^3]
CLEAR = 0.003  # [m] between the support and the jaws
SLIP = 0.005  # [m] largest displacement of the cube in the closed hand
THICK, RIM = 0.01, 0.02  # [m] thickness of the plate, and edge beyond the cups
CLOSE = 0.0003  # [m] between the rings and the plate before the vacuum is on
FORCE = 30.0  # [N] per finger, if the gripper has it


@dataclass(frozen=True)
class GripperProof:
    """Proof that a gripper works: the result of a simulation in which it holds a cube or plate.

    Attributes:
        gripper: the gripper that was tried.
        edge: edge of the cube or plate [m].
        held: whether the hand held the object while it was lifted and shaken.
        slip: displacement of the object in the hand [m].
        text: the result in words.
    """

    gripper: Gripper
    edge: float
    held: bool
    slip: float
    text: str


def with_proven_grippers(model: RobotModel) -> tuple[RobotModel, tuple[GripperProof, ...]]:
    """Test whether each gripper of a robot holds a cube in simulation. Return the robot with only the
    successful grippers, and all test results.
    """
    proofs = tuple(prove_gripper(model, gripper) for gripper in model.grippers.values())
    held = {p.gripper.name: p.gripper for p in proofs if p.held}
    return replace(model, grippers=held), proofs


def prove_gripper(model: RobotModel, gripper: Gripper) -> GripperProof:
    """Prove that a detected gripper works: close it on a cube in the physics simulation,
    lift the cube and shake it.
    """
    try:
        return _tried(model, gripper)
    except InputError as error:
        return GripperProof(gripper, 0.0, False, float("inf"), f"physics refuses the hand: {error}")


def _tried(model: RobotModel, gripper: Gripper) -> GripperProof:
    from armcell.sim.grasp_trials import GraspTrial, run_trials  # imported late: physics

    if isinstance(gripper, SuctionGripper):
        return _sucked(model, gripper)
    edge = round(min(SHARE * gripper.max_width, LARGEST), 4)
    limits = model.joints[gripper.joint_name].limits
    position = float(np.clip(gripper.joint_position(0.0), limits.lower, limits.upper))
    narrow = gripper.width(position)
    if narrow > edge:
        text = (
            f"its jaws close only to {1000 * narrow:.0f} mm, where joint {gripper.joint_name} is at its "
            f"limit {position:.3g}: check the joint's limits and the fingers' collision geometry"
        )
        return GripperProof(gripper, edge, False, float("inf"), text)
    cube = CollisionObject.single("cube", Box(edge, edge, edge), SE3.identity(), movable=True)
    opening = min(gripper.max_width, 1.3 * edge + 0.004)
    hand = hand_of(model, gripper)
    beyond = float(np.concatenate([hand.left, hand.right])[:, 5].max()) - edge / 2
    # From above, with the support just beyond the jaws' ends.
    center = SE3.from_xyz_rpy((0.0, 0.0, max(beyond + CLEAR, 0.0)), (np.pi, 0.0, 0.0))
    trial = GraspTrial(
        T_object_tcp=center @ gripper.grip_center(edge, opening).inverse(),
        opening=opening,
        width=edge,
        force=min(FORCE, gripper.max_force),
        friction=0.8,
        mass=DENSITY * edge**3,
        up=(0.0, 0.0, 1.0),
    )
    (result,) = run_trials(model, gripper, cube, [trial])
    held = not result.lost and result.slip < SLIP
    size, slip = 1000 * edge, 1000 * result.slip
    if held:
        text = f"holds a cube of {size:.0f} mm, lifted and shaken in physics (slip {slip:.1f} mm)"
    elif result.lost:
        text = f"loses a cube of {size:.0f} mm when it is lifted and shaken in physics"
    else:
        text = f"a cube of {size:.0f} mm slips by {slip:.0f} mm in physics"
    return GripperProof(gripper, edge, held, result.slip, text)


def _sucked(model: RobotModel, gripper: SuctionGripper) -> GripperProof:
    """Prove that a suction gripper works: let it hold a plate that all its cups cover, with half the load
    that it may carry.
    """
    from armcell.sim.grasp_trials import GraspTrial, run_trials  # imported late: physics

    reach = np.linalg.norm(hand_of(model, gripper).cups[:, :2], axis=1) + [c.radius for c in gripper.cups]
    edge = round(2 * float(reach.max()) + RIM, 4)
    plate = CollisionObject.single("plate", Box(edge, edge, THICK), SE3.identity(), movable=True)
    load = sum(map(gripper.force, gripper.cups)) / (9.81 + LIFT_ACCELERATION) / gripper.safety
    trial = GraspTrial(
        T_object_tcp=SE3.from_xyz_rpy((0.0, 0.0, THICK / 2 + CLOSE), (np.pi, 0.0, 0.0)),
        opening=gripper.max_width,
        width=0.0,
        force=gripper.max_force,
        friction=0.5,
        mass=load / 2,
        up=(0.0, 0.0, 1.0),
    )
    (result,) = run_trials(model, gripper, plate, [trial])
    held = not result.lost and result.slip < SLIP
    what = f"a plate of {1000 * edge:.0f} mm and {load / 2:.1f} kg"
    if held:
        text = f"holds {what}, lifted and shaken in physics (slip {1000 * result.slip:.1f} mm)"
    else:
        text = f"loses {what} when it is lifted and shaken in physics"
    return GripperProof(gripper, edge, held, result.slip, text)

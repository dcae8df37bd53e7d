"""Physics of one emulated Franka arm: torque-driven joints, hand and external torques."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import InputError
from armcell.emulators.franka.kinematics import JOINTS, ArmKinematics, arm_joints
from armcell.emulators.rack import SharedWorld

Array = NDArray[np.float64]

PERIOD = 0.001  # [s]
FILTER = 30.0  # [Hz] cutoff of the external torques' low-pass filter
SHARE = 1.0 - np.exp(-2.0 * np.pi * FILTER * PERIOD)  # of one step of the filter


class FrankaPlant:
    """Plant of an emulated Franka arm: the arm in a physics world, driven by joint torques at 1 kHz.

    Args:
        shared: a world with `arm_control: "torque"` whose time step divides 1 ms.
        group: planning group of the arm.
    Raises:
        InputError: the group is not a Franka arm, or the world cannot be driven at 1 kHz by torques.
    """

    def __init__(self, shared: SharedWorld, group: str):
        self._shared, self.world = shared, shared.world
        shared.join(self, PERIOD)
        world = self.world
        self.names = arm_joints(world.robot, group)
        steps = round(PERIOD / world.timestep)
        if steps < 1 or abs(steps * world.timestep - PERIOD) > 1e-9:
            raise InputError(f"the world's time step of {world.timestep} s does not divide 1 ms")
        joints = [world.robot.joints[n] for n in self.names]
        self.kinematics = ArmKinematics(joints)
        grippers = [g for g in world.robot.grippers.values() if g.arm_group == group]
        self.hand = grippers[0] if grippers else None
        self.links = set(world.robot.group(group).link_names) | {joints[0].parent}
        if self.hand is not None:
            self.links |= set(self.hand.hand_links)
        self._base, self._tip = world.built.body[joints[0].parent], joints[-1].child
        self._fixed = world.mj_model.body_weldid[self._base] == 0
        self._dofs = world.built.dofs[world.robot.columns(self.names)]
        self._qpos = world.built.qpos[world.robot.columns(self.names)]
        self._payload = 0.0  # [kg] unknown to the controller
        self._offset = np.zeros(JOINTS)
        self.push = np.zeros(3)  # [N] force of a person on the last link, world frame
        self.resets = -1
        self.follow_reset()

    def reset(self) -> None:
        """Reset all arms and objects in the world of the Franka plant to their initial state."""
        self._shared.reset()

    def follow_reset(self) -> None:
        self.resets += 1
        self._filtered, self._seen = np.zeros(JOINTS), 0
        self.push = np.zeros(3)
        if self.hand is not None:
            movable = tuple(self.world.built.object_qpos)
            for link in self.hand.hand_links:
                self.world.monitor.allow(link, movable)

    # --- measurements ---
    def read(self) -> tuple[Array, Array]:
        """Return the joint positions [rad] and velocities [rad/s], each (7,), measured on the Franka
        plant.
        """
        data = self.world.mj_state
        return data.qpos[self._qpos] + self._offset, data.qvel[self._dofs]

    def torques(self) -> Array:
        """Return the joint torques (7,) [Nm] measured on the Franka plant,
        which include the weight of the links.
        """
        data = self.world.mj_state
        return data.qfrc_actuator[self._dofs] + data.qfrc_gravcomp[self._dofs]

    def external_torques(self) -> Array:
        """Return the external torques (7,) [Nm] on the Franka plant:
        the measured torques minus the robot's own dynamics.

        Forces of the robot on its environment are positive. The configured load is not subtracted.
        """
        return self._filtered

    def inertial_torque(self, acceleration: Array) -> Array:
        """Compute the joint torques (7,) [Nm] that accelerate the arm and hand of the Franka plant as desired
        (7,) [rad/s^2], from the mass matrix.
        """
        model, data = self.world.mj_model, self.world.mj_state
        wanted, torque = np.zeros(model.nv), np.zeros(model.nv)
        wanted[self._dofs] = acceleration
        mujoco.mj_mulM(model, data, torque, wanted)
        return torque[self._dofs]

    def coriolis(self) -> Array:
        """Return the Coriolis and centrifugal torques (7,) [Nm] of the Franka plant in the current state."""
        data, dofs = self.world.mj_state, self._dofs
        return data.qfrc_bias[dofs] - data.qfrc_gravcomp[dofs] - self._weight()

    def friction_torques(self) -> Array:
        """Return the torques (7,) [Nm] that compensate the viscous
        friction in the joints of the Franka plant.
        """
        data, dofs = self.world.mj_state, self._dofs
        return data.qfrc_gravcomp[dofs] - data.qfrc_passive[dofs]  # MuJoCo's passive forces have both

    def inertia(self) -> Array:
        """Return the diagonal (7,) [kg m^2] of the Franka plant's joint-space inertia matrix."""
        model, data = self.world.mj_model, self.world.mj_data
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        return np.diag(full)[self._dofs].copy()

    def _weight(self) -> Array:
        """Return the joint torques (7,) [Nm] that support the weight of a payload attached to the Franka
        plant. The arm's controller does not know this payload.
        """
        if not self._payload:
            return np.zeros(JOINTS)
        return self._tip_torque(-self._payload * np.asarray(self.world.settings.gravity))

    def _tip_torque(self, force: Array) -> Array:
        """Return the joint torques (7,) [Nm] that a force (3,) [N] at the center of mass of the Franka
        plant's last link produces.

        The force is in the world frame.
        """
        jacobian = np.zeros((3, self.world.mj_model.nv))
        body = self.world.built.body[self._tip]
        mujoco.mj_jacBodyCom(self.world.mj_model, self.world.mj_state, jacobian, None, body)
        return jacobian[:, self._dofs].T @ force

    def load_torque(self, mass: float, center: Array) -> Array:
        """Return the joint torques (7,) [Nm] with which the Franka
        plant carries a mass [kg] at a point (3,) [m].

        The point is in the flange frame.
        """
        point = np.eye(4)
        point[:3, 3] = center
        jacobian = self.kinematics.pose_and_jacobian(self.read()[0], point)[1]
        data = self.world.mj_state if self._fixed else self.world.mj_data
        R = data.xmat[self._base].reshape(3, 3)
        return jacobian[:3].T @ (R.T @ -np.asarray(self.world.settings.gravity) * mass)

    def take_unexpected_contacts(self) -> list[tuple[str, str]]:
        """Return the unexpected contacts (pairs of bodies) of the Franka plant since the last call.

        The first body of each pair is a link of the arm.
        """
        new = self.world.monitor.unwanted[self._seen :]
        self._seen += len(new)
        pairs = [(t.body_a, t.body_b) if t.body_a in self.links else (t.body_b, t.body_a) for t in new]
        return [p for p in pairs if p[0] in self.links]

    def contact(self) -> str:
        """Describe the strongest contact of the Franka plant in the physics world, such as "panda_hand on
        wall".
        """
        mine = [c for c in self.world.contacts() if self.links & {c.body_a, c.body_b}]
        if not mine:
            return "no contact"
        most = max(mine, key=lambda c: c.force)
        return f"{most.body_a} on {most.body_b}"

    # --- commands ---
    def apply(self, torque: Array) -> None:
        """Apply joint torques (7,) [Nm] to the Franka plant, in addition to gravity compensation."""
        self.world.set_arm_torque(self.names, torque)

    def set_joint_targets(self, time: float) -> None:
        """Do nothing: the Franka plant is driven by joint torques, so it has no position targets to
        interpolate.
        """

    def step(self) -> None:
        """Advance the physics world of the Franka plant by 1 ms."""
        body = self.world.built.body[self._tip]
        self.world.mj_state.xfrc_applied[body, :3] = self.push
        self._shared.advance(PERIOD)
        data = self.world.mj_state
        felt = data.qfrc_constraint[self._dofs].copy()
        if self.push.any():
            felt += self._tip_torque(self.push)
        self._filtered = self._filtered + SHARE * (self._weight() - felt - self._filtered)

    # --- faults ---
    def displace(self, q: ArrayLike) -> None:
        """Set the joint positions (7,) [rad] of the Franka plant at once, as if a person had moved the arm by
        hand.
        """
        positions = np.array(self.world.joint_state().positions)
        positions[self.world.robot.columns(self.names)] = q
        self.world.set_positions(np.clip(positions, self.world.robot.lower, self.world.robot.upper))

    def attach_payload(self, mass: float) -> None:
        """Attach a mass [kg] to the last link of the Franka plant without informing the controller."""
        self.world.add_load(self._tip, mass)
        self._payload += mass

    def block_joint(self, joint: int) -> None:
        """Block a joint (0 to 6) of the Franka plant at its present position, so that no torque moves it."""
        self.world.block(self.names[joint])

    def set_encoder_offset(self, joint: int, angle: float) -> None:
        """Add an error [rad] to the measured position of a joint of the Franka plant,
        like an encoder with a wrong zero position.
        """
        self._offset[joint] = angle

"""Writer of the state message of an emulated Franka arm."""

from __future__ import annotations

import numpy as np

from armcell.drivers.franka import motion_limits
from armcell.drivers.franka.wire.errors import INDEX
from armcell.drivers.franka.wire.state import StateMessage
from armcell.emulators.franka.motion_generators import elbow_of
from armcell.emulators.franka.robot import Robot


class StateWriter:
    """Writer for the state of an emulated Franka robot. It reuses one message buffer in every cycle."""

    def __init__(self, robot: Robot, version: int = 10):
        self._robot, self._message = robot, StateMessage(version)
        m = self._message
        m["F_T_NE"] = robot.T_F_NE.T.ravel()
        m["O_ddP_O"] = (0.0, 0.0, -9.81)
        if robot.plant.hand is not None:
            m["m_ee"], m["F_x_Cee"] = motion_limits.HAND_MASS, motion_limits.HAND_CENTER
            m["I_ee"] = np.diag(motion_limits.HAND_INERTIA).ravel()

    def write(self) -> bytes:
        """Write the state of the emulated Franka arm, and return the message for the current millisecond."""
        r, m = self._robot, self._message
        reference, motion = r.reference, r.motion
        cartesian = motion is not None and motion.generator.cartesian
        wanted = r.O_T_EE_d
        commanded = reference.T if cartesian else wanted
        m["O_T_EE"], m["O_T_EE_d"] = r.O_T_EE.T.ravel(), wanted.T.ravel()
        m["O_T_EE_c"] = commanded.T.ravel()
        m["F_T_EE"], m["NE_T_EE"], m["EE_T_K"] = r.F_T_EE.T.ravel(), r.NE_T_EE.T.ravel(), r.EE_T_K.T.ravel()
        m["m_load"], m["F_x_Cload"], m["I_load"] = r.load.mass, r.load.center, r.load.inertia
        m["elbow"], m["elbow_d"] = r.elbow, elbow_of(reference.q)
        m["elbow_c"] = reference.elbow if cartesian else elbow_of(reference.q)
        m["tau_J"], m["tau_J_d"], m["dtau_J"] = r.plant.torques(), r.torque, r.torque_rate
        m["q"], m["q_d"], m["dq"], m["dq_d"] = r.q, reference.q, r.dq, reference.dq
        m["ddq_d"], m["theta"], m["dtheta"] = reference.ddq, r.q, r.dq
        m["joint_contact"], m["cartesian_contact"] = r.joint_contact, r.cartesian_contact
        m["joint_collision"], m["cartesian_collision"] = r.joint_collision, r.cartesian_collision
        m["tau_ext_hat_filtered"] = r.tau_ext
        m["O_F_ext_hat_K"], m["K_F_ext_hat_K"] = r.O_F_K, r.K_F_K
        m["O_dP_EE_d"], m["O_dP_EE_c"] = reference.twist, reference.twist
        m["O_ddP_EE_c"] = reference.dtwist
        for flags, names in ((m.errors, r.errors), (m.reflex_reason, r.last_errors)):
            flags[:] = 0
            for name in names:
                flags[INDEX[name]] = 1
        m.write_scalars(r.time, r.generator_mode, r.controller_mode, r.mode, r.success_rate)
        return bytes(m)

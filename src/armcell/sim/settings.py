"""`PhysicsSettings`: all parameters of the physics simulation.

The defaults were tuned on MuJoCo 4.0 (2 ms, discrete, elliptic cones, impratio 10, stiff contacts of the
grasped object). With MuJoCo's own defaults, a 0.1 kg cube slides 4.4 mm out of a Panda's hand in 5 s.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from armcell.core import InputError, UnknownNameError
from armcell.core.checks import checked, float_array
from armcell.model import Joint
from armcell.sim.joint_gains import GainTable

INTEGRATORS = ("Euler", "RK4", "implicit", "implicitfast", "discrete")
CONES = ("pyramidal", "elliptic")
GRIP_MODES = ("friction", "weld", "hybrid")
ARM_CONTROLS = ("pid", "position", "torque")
INTEGRAL_SHARE = 0.2  # largest integral effort as a fraction of the effort limit; prevents windup


@dataclass(frozen=True)
@checked()
class PhysicsSettings:
    """Settings of the physics simulation: solver, joints, grippers and grip modes (SI units).

    Raises:
        UnknownNameError: the integrator, cone, grip mode or arm control does not exist.
        InputError: a number is out of range.
    """

    timestep: float = 0.002  # [s]
    # "discrete" solves contacts and servos together. "implicitfast" solves contacts first and then adds the
    # servos' damping, which pulls the fingers from under a held object. At an arm speed of 0.5 m/s, a held
    # object is displaced by 2.6 mm and 14 mrad with "implicitfast" (until the arm stops), but by 0.4 mm and
    # 0.0 mrad with "discrete". "discrete" also works at a time step of 5 ms.
    integrator: str = "discrete"
    cone: str = "elliptic"
    # Ratio of friction to normal impedance. A loaded contact creeps at a speed proportional to 1 / impratio
    # (see holding.py), but with large values a step takes several solver iterations while forces change.
    impratio: float = 10.0
    holding_impratio: float = (
        1e5  # the same while a hand at rest holds an object: creep below 0.1 um/s at 2 kg
    )
    iterations: int = 100
    noslip_iterations: int = 0  # 2 stops creep in motion, too, but a trial takes 1.3 times the CPU time
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)  # [m/s^2]
    # Resting objects sleep until another body touches them; useful in cells with many objects.
    sleep: bool = False

    # Arm joints, within JointLimits.effort. "pid": MuJoCo's servo, force = kp (u_pos - q) + kv (u_vel - qd).
    # "position": kp (u_pos - q) - kv qd, which lags by kv/kp times the speed. "torque": the pid law plus
    # ki times the integral of (u_pos - q), computed by armcell at every step and commanded as a torque.
    arm_control: str = "pid"
    arm_kp: float = 5000.0  # [Nm/rad]
    arm_ki: float = 0.0  # [Nm/(rad s)], only for "torque"; the integral effort is at most 1/5 of the limit
    arm_kv: float = 250.0  # [Nm s/rad]; with 500 a UR10's wrist chatters once its torque has saturated
    joint_gains: GainTable = GainTable()  # gains of individual joints; override the gains above and below
    gravity_compensation: float = 1.0  # fraction of the links' weight that the arms compensate
    full_gain_effort: float = 50.0  # [Nm or N] joints with a lower limit get proportionally lower gains
    slide_kp: float = 50000.0  # [N/m], prismatic joints except gripper fingers
    slide_kv: float = 5000.0  # [N s/m]
    armature: float = 0.1  # [kg m^2 or kg] rotor inertia: keeps a joint stable when its force saturates
    joint_damping: float = 1.0  # [Nm s/rad or N s/m] lower bound of every joint's damping

    # Fingers: each gripper has one position servo, which controls the mean position of its finger joints.
    gripper_kp: float = 1000.0  # [N/m]
    gripper_kv: float = 20.0  # [N s/m]
    gripper_force: float = 140.0  # [N] upper limit of the servo force; the gripper's max_force also applies
    finger_speed: float = 0.05  # [m/s] upper limit per finger; the joint's velocity limit also applies
    grip_force_rate: float = 200.0  # [N/s] rate at which the force of a blocked finger rises

    # Contacts of movable objects. Their geoms have priority 1, so their friction, solref, solimp and condim
    # apply in contacts with links and fixed objects, which keep MuJoCo's defaults.
    object_solref: tuple[float, float] = (0.004, 1.0)  # time constant [s], damping ratio
    object_solimp: tuple[float, float, float, float, float] = (0.95, 0.99, 0.001, 0.5, 2.0)
    object_condim: int = 4  # 3: sliding friction, 4: also torsional friction, 6: also rolling friction

    # Grip modes. Only "friction" is pure physics; `SimWorld.welds` records each weld of the other modes.
    grip_mode: str = "friction"
    weld_force: float = 2.0  # [N] per finger from which "weld" fixes the object or "hybrid" monitors its slip
    weld_solref: tuple[float, float] = (0.004, 1.0)
    hybrid_solref: tuple[float, float] = (0.04, 1.0)  # soft weld: ten times slower than the contacts
    hybrid_slip: float = 0.002  # [m] slip above which "hybrid" fixes the object
    hybrid_turn: float = 0.05  # [rad] rotation in the hand above which "hybrid" fixes the object

    def __post_init__(self) -> None:
        for kind, value, known in (
            ("integrator", self.integrator, INTEGRATORS),
            ("cone", self.cone, CONES),
            ("grip mode", self.grip_mode, GRIP_MODES),
            ("arm control", self.arm_control, ARM_CONTROLS),
        ):
            if value not in known:
                raise UnknownNameError(kind, value, known)
        if self.object_condim not in (3, 4, 6):
            raise InputError(f"object_condim is {self.object_condim}", hint="use 3, 4 or 6")
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, str) or field.name in ("gravity", "joint_gains"):
                continue
            if np.any(float_array(value, None, f"physics setting {field.name}") < 0):
                raise InputError(f"physics setting {field.name} is {value}, it must be a number >= 0")
        for name in (
            "timestep",
            "gripper_kp",
            "finger_speed",
            "grip_force_rate",
            "impratio",
            "holding_impratio",
        ):
            if getattr(self, name) <= 0:
                raise InputError(f"physics setting {name} is {getattr(self, name)}, it must be above 0")
        if self.arm_control != "torque":
            self._check_servo()
        if len(self.gravity) != 3 or not np.all(np.isfinite(self.gravity)):
            raise InputError("physics setting gravity must be three finite numbers [m/s^2]")

    def _check_servo(self) -> None:
        """Reject physics settings with integral or feedforward gains,
        because MuJoCo's servos do not support them.
        """
        if self.arm_ki > 0:
            raise InputError(
                f"physics setting arm_ki is for arm_control 'torque', this is {self.arm_control!r}"
            )
        for joint, gains in self.joint_gains.items():
            if gains.i > 0 or gains.ff_velocity_scale > 0:
                raise InputError(
                    f"joint_gains/{joint} has i or ff_velocity_scale, which arm_control "
                    f"{self.arm_control!r} does not have",
                    hint="set arm_control: torque",
                )


class EffectiveGains(NamedTuple):
    """Effective PID gains of one joint after scaling, with the limits on the effort of the integral term."""

    kp: float
    ki: float
    kv: float
    low: float  # [Nm or N], negative
    high: float  # [Nm or N]
    winds_up: bool
    feedforward: float


def effective_gains(joint: Joint, settings: PhysicsSettings) -> EffectiveGains:
    """Return the PID gains after scaling that the simulation uses for an arm joint."""
    effort = joint.limits.effort
    most = INTEGRAL_SHARE * effort if np.isfinite(effort) else np.inf
    own = settings.joint_gains.get(joint.name)
    if own is not None:
        clamp = most if own.i_clamp < 0 else own.i_clamp
        low = clamp if own.i_clamp_min < 0 else own.i_clamp_min
        high = clamp if own.i_clamp_max < 0 else own.i_clamp_max
        return EffectiveGains(own.p, own.i, own.d, -low, high, not own.antiwindup, own.ff_velocity_scale)
    if joint.servo is not None:
        return EffectiveGains(joint.servo.kp, 0.0, joint.servo.kv, -most, most, False, 0.0)
    # A weak joint with a strong joint's gains would saturate at every small error and chatter.
    weak = min(1.0, effort / settings.full_gain_effort)
    slides = joint.type == "prismatic"
    kp = settings.slide_kp if slides else settings.arm_kp
    kv = settings.slide_kv if slides else settings.arm_kv
    return EffectiveGains(weak * kp, weak * settings.arm_ki, weak * kv, -most, most, False, 0.0)

"""`PhysicsSettings`: every number of the physics in one place.

The defaults are a recipe measured on MuJoCo 4.0 (2 ms, discrete, elliptic cones, impratio 10, stiff contacts
of the grasped object): the engine's own defaults let a 0.1 kg cube slide 4.4 mm out of a Panda's hand in 5 s.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from armcell.core import InputError, UnknownNameError
from armcell.core.checks import checked, float_array

INTEGRATORS = ("Euler", "RK4", "implicit", "implicitfast", "discrete")
CONES = ("pyramidal", "elliptic")
GRIP_MODES = ("friction", "weld", "hybrid")
ARM_CONTROLS = ("pid", "position", "torque")


@dataclass(frozen=True)
@checked()
class PhysicsSettings:
    """How the physics is solved and how joints, fingers and grips are driven. SI units.

    Raises:
        UnknownNameError: integrator, cone or grip_mode that does not exist.
        InputError: a number out of its range.
    """

    timestep: float = 0.002  # [s]
    # "discrete" solves contacts and servos together. "implicitfast" solves contacts first and then adds the
    # servos' damping, which pulls the fingers from under a held object: measured, at 0.5 m/s it is 2.6 mm and
    # 14 mrad out of place (back when the arm stops) against 0.4 mm and 0.0 mrad. It also holds at 5 ms.
    integrator: str = "discrete"
    cone: str = "elliptic"
    impratio: float = 10.0  # friction over normal impedance: what keeps a held object from creeping
    iterations: int = 100
    noslip_iterations: int = 0  # 2 lowers the creep of a held object six times, at 2/3 of the speed
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)  # [m/s^2]
    # Objects that lie still are not worked out until something touches them: for cells with many objects.
    sleep: bool = False

    # Arm joints, within JointLimits.effort. "pid": the engine's, force = kp (u_pos - q) + kv (u_vel - qd).
    # "position": kp (u_pos - q) - kv qd, which lags by kv/kp times the speed. "torque": the pid law and
    # ki times the integral of (u_pos - q), worked out here at every step and sent as a torque.
    arm_control: str = "pid"
    arm_kp: float = 5000.0  # [Nm/rad]
    arm_ki: float = 0.0  # [Nm/(rad s)], of "torque"; the integral gives at most a fifth of the effort limit
    arm_kv: float = 250.0  # [Nm s/rad]; with 500 a UR10's wrist chatters once its torque has saturated
    gravity_compensation: float = 1.0  # share of the links' weight that the arms take off themselves
    full_gain_effort: float = 50.0  # [Nm or N] joints with a lower effort limit get gains in proportion to it
    slide_kp: float = 50000.0  # [N/m], of sliding joints that are no fingers
    slide_kv: float = 5000.0  # [N s/m]
    armature: float = 0.1  # [kg m^2 or kg] rotor inertia: keeps a joint stable when its force saturates
    joint_damping: float = 1.0  # [Nm s/rad or N s/m], at least

    # Fingers: one position servo per gripper on the mean of its finger joints.
    gripper_kp: float = 1000.0  # [N/m]
    gripper_kv: float = 20.0  # [N s/m]
    gripper_force: float = 140.0  # [N] of the servo at most; a gripper's own max_force binds too
    finger_speed: float = 0.05  # [m/s] of each finger at most; the joint's velocity limit binds too
    grip_force_rate: float = 200.0  # [N/s] how fast the force per finger rises once the fingers are blocked

    # Contacts of movable objects. Their geoms have priority 1: THEIR friction, solref, solimp and condim
    # decide against links and fixed things, which keep the engine's defaults.
    object_solref: tuple[float, float] = (0.004, 1.0)  # time constant [s], damping ratio
    object_solimp: tuple[float, float, float, float, float] = (0.95, 0.99, 0.001, 0.5, 2.0)
    object_condim: int = 4  # 3: sliding friction, 4: and torsional, 6: and rolling

    # Grip modes. Only "friction" is plain physics; each weld of the others is recorded in `SimWorld.welds`.
    grip_mode: str = "friction"
    weld_force: float = 2.0  # [N] on each finger before "weld" fixes the object or "hybrid" watches it
    weld_solref: tuple[float, float] = (0.004, 1.0)
    hybrid_solref: tuple[float, float] = (0.04, 1.0)  # weak: ten times slower than the contacts
    hybrid_slip: float = 0.002  # [m] of slip before "hybrid" fixes the object
    hybrid_turn: float = 0.05  # [rad] of slip before "hybrid" fixes the object

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
            raise InputError(f"object_condim is {self.object_condim}", cure="use 3, 4 or 6")
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, str) or field.name == "gravity":
                continue
            if np.any(float_array(value, None, f"physics setting {field.name}") < 0):
                raise InputError(f"physics setting {field.name} is {value}, it must be a number >= 0")
        for name in ("timestep", "gripper_kp", "finger_speed", "grip_force_rate", "impratio"):
            if getattr(self, name) <= 0:
                raise InputError(f"physics setting {name} is {getattr(self, name)}, it must be above 0")
        if self.arm_ki > 0 and self.arm_control != "torque":
            raise InputError(
                f"physics setting arm_ki is for arm_control 'torque', this is {self.arm_control!r}"
            )
        if len(self.gravity) != 3 or not np.all(np.isfinite(self.gravity)):
            raise InputError("physics setting gravity must be three finite numbers [m/s^2]")

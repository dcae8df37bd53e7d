"""Dry run of a trajectory in simulation, from the measured state of the real robot, and its flange load.

Least squares on the dynamics, which are linear in the mass (Atkeson, An and Hollerbach, "Estimation of
inertial parameters of manipulator loads and links", 1986). Using all joints together reveals a load that no
single joint's band reveals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, ErrorCode, InputError, JointState, JointTrajectory, Outcome
from armcell.drivers.driver import DriverOptions
from armcell.drivers.sim import SimDriver
from armcell.execution import UngatedMotion, execute
from armcell.kinematics import InverseDynamics
from armcell.model import Inertial, RobotModel
from armcell.scene import PlanningScene
from armcell.sim import PhysicsSettings, SimWorld

Array = NDArray[np.float64]

UNTOLD = 1.0  # [kg] prior standard deviation of a mass: keeps poorly observable masses near 0


@dataclass(frozen=True, eq=False)
class LoadEfforts:
    """Joint efforts in a dry run with which the load on the flange is estimated: those that a load of 1 kg
    adds, and those that accelerate the empty arm.
    """

    weight: Array  # (k, n) [Nm/kg] gravity torque of a mass at the flange
    inertia: Array  # (k, n) [Nm/kg] torque to accelerate the mass at full speed
    swing: Array  # (k, n) [Nm] torque to accelerate the arm itself at full speed


def load_efforts(model: RobotModel, trajectory: JointTrajectory, times: Array) -> LoadEfforts:
    """Compute the joint efforts with which a dry run estimates the load on the flange, at times (k,) [s] of a
    trajectory: efforts per kilogram of load, and efforts that accelerate the empty arm.

    The load is a point mass at the origin of each arm's last link. `swing` excludes held objects.
    """
    names = trajectory.joint_names
    children = [model.joint(name).child for name in names]
    last = [link for link in children if not set(model.subtree(link)[1:]) & set(children)]
    rows = [trajectory.sample(t) for t in times]
    q, v, a = (np.array(column) for column in zip(*rows))
    still = np.zeros_like(q)
    rest, moving = [], []
    for mass in (1.0, 2.0):  # torques are linear in it; 0 would fail for a robot without masses
        loads = [(link, Inertial(mass, SE3.identity(), np.zeros((3, 3)))) for link in last]
        dynamics = InverseDynamics(model, names, payloads=loads)
        rest.append(dynamics.torques(q, still, still))
        moving.append(dynamics.torques(q, v, a))
    weight, inertia = rest[1] - rest[0], moving[1] - moving[0] - (rest[1] - rest[0])
    return LoadEfforts(weight, inertia, moving[0] - rest[0] - inertia)


def estimate_load(wrong: Array, kilo: Array, spread: Array) -> float:
    """Estimate the load on the flange from a dry run: return the additional mass [kg] that best explains the
    difference between measured and expected motor currents.

    The result is the expected value under a zero-mean normal prior with standard deviation `UNTOLD`.

    Args:
        wrong: measured minus expected currents of m samples (m, n) [A].
        kilo: current per kilogram of load (m, n) [A/kg].
        spread: standard deviation of `wrong` in fault-free motions (n,) [A]. Errors of successive samples are
            correlated, so all samples together weigh as one.
    """
    seen, sure = np.mean(wrong * kilo / spread**2, axis=0).sum(), np.mean((kilo / spread) ** 2, axis=0).sum()
    return float(seen / (sure + 1.0 / UNTOLD**2))


@dataclass(frozen=True, eq=False)
class DryRun:
    """Result of a dry run (rehearsal): the simulated course of a trajectory, or the reason why the robot must
    not execute it.

    Attributes:
        outcome: SUCCESS, or CONTROL_FAILED with the bodies that touch or the joint that did not follow.
    """

    outcome: Outcome
    joint_names: tuple[str, ...]
    times: Array  # (k,) [s]
    positions: Array  # (k, n) [rad]
    velocities: Array  # (k, n) [rad/s]
    efforts: Array  # (k, n) [Nm], gravity included
    demand: LoadEfforts

    def at(self, t: float) -> tuple[Array, Array, Array]:
        """Return the position, velocity and effort, each (n,), that a dry-run (rehearsed) motion has at a
        time [s].

        Before the start and after the end, the nearest values apply.
        """
        q, v, effort = self._between(t, self.positions, self.velocities, self.efforts)
        return q, v, effort

    def efforts_at(self, t: float, scaling: float) -> tuple[Array, Array]:
        """Compute the joint efforts of a dry-run motion at reduced speed.
        Also compute the additional effort per kilogram of load.

        Args:
            t: trajectory time [s].
            scaling: speed fraction, 0 to 1, at which the trajectory is played.
        Returns:
            Efforts (n,) [Nm]; additional effort per kilogram on the flange (n,) [Nm/kg].
        """
        of = self.demand
        effort, swing, weight, inertia = self._between(t, self.efforts, of.swing, of.weight, of.inertia)
        return effort - (1.0 - scaling**2) * swing, weight + scaling**2 * inertia

    def _between(self, t: float, *rows: Array) -> list[Array]:
        """Interpolate arrays (k, n) of a dry-run (rehearsed) motion at a time [s]; before the start and after
        the end, the nearest values apply.
        """
        k = int(np.searchsorted(self.times, t))
        if k == 0 or k == len(self.times):
            k = min(k, len(self.times) - 1)
            return [x[k] for x in rows]
        s = (t - self.times[k - 1]) / (self.times[k] - self.times[k - 1])
        return [(1 - s) * x[k - 1] + s * x[k] for x in rows]


class TwinSimulation:
    """Physics simulation in which motions of a cell are dry-run (rehearsed) from the measured state.

    Args:
        scene: scene of the cell.
        settings: physics settings of the cell.
    """

    def __init__(self, scene: PlanningScene, settings: PhysicsSettings):
        self._scene, self._settings = scene, settings
        self._world: SimWorld | None = None
        self._expected: set[tuple[str, str]] = set()
        self._watched: dict[str, tuple[str, ...]] = {}

    # --- expected contacts, as for a simulated robot ---
    def expect_contact(self, body: str, others: tuple[str, ...], expected: bool) -> None:
        pairs = {(body, other) for other in others}
        self._expected = self._expected | pairs if expected else self._expected - pairs

    def watch_object(self, name: str, supports: tuple[str, ...]) -> None:
        self._watched[name] = supports

    def unwatch_object(self, name: str) -> None:
        self._watched.pop(name, None)

    # --- simulation ---
    def play(
        self,
        trajectory: JointTrajectory,
        state: JointState,
        poses: Mapping[str, SE3],
        held: Mapping[str, str],
    ) -> DryRun:
        """Dry-run (rehearse) a trajectory in simulation, starting from the measured state of the real robot.

        Args:
            state: measured state of all joints.
            poses: T_world_object of the movable objects.
            held: gripper name to the held object, which is fixed to the hand.
        """
        world = self._placed(state, poses, held)
        driver = SimDriver(self._scene, DriverOptions(physics=self._settings))
        driver.world = world
        names, began = trajectory.joint_names, world.time
        columns = list(world.robot.columns(names))
        times: list[float] = []
        rows: list[tuple[Array, Array, Array]] = []

        def keep(_: float) -> None:
            now = world.joint_state()
            if now.velocities is None or now.efforts is None:
                raise InputError("the twin's world tells no speeds and efforts", hint="dry-run in a SimWorld")
            times.append(world.time - began)
            rows.append((now.positions[columns], now.velocities[columns], now.efforts[columns]))

        keep(0.0)
        result: Outcome = execute(driver, UngatedMotion(trajectory), progress=keep)
        touched = world.monitor.unwanted
        if touched:
            first = touched[0]
            result = Outcome(
                ErrorCode.CONTROL_FAILED,
                f"in physics {first.body_a} touches {first.body_b} at {first.time - began:.2f} s",
                {"pair": (first.body_a, first.body_b), "time_s": first.time - began},
            )
        elif not result.ok:
            result = replace(result, message=f"in physics: {result.message}")
        q, v, effort = (np.array(column) for column in zip(*rows))
        clock = np.array(times)
        return DryRun(result, names, clock, q, v, effort, load_efforts(self._scene.model, trajectory, clock))

    def _placed(self, state: JointState, poses: Mapping[str, SE3], held: Mapping[str, str]) -> SimWorld:
        scene = self._scene
        for name, pose in poses.items():
            if name in scene.objects:
                scene = scene.with_object_pose(name, pose)
        model = scene.model
        q = np.clip(state.reindexed(model.joint_names).positions, model.lower, model.upper)
        scene = replace(scene, positions=q)
        if self._world is None:
            self._world = SimWorld(scene, self._settings)
        else:
            self._world.reset(scene)
        world = self._world
        for gripper, item in held.items():
            if item in world.built.object_qpos:  # a threaded part has none: it stays on its thread
                world.fix_in_hand(item, gripper)
        for body, other in self._expected:
            world.monitor.allow(body, other)
        for name, supports in self._watched.items():
            world.monitor.watch(name, supports)
        return world

"""Guided bring-up of a cell's real arms: explain, confirm, perform and record each step.

The steps follow docs/real_ur.md: network, identity, power, geometry, slow motions of single joints, a short
line compared with its preview while the other arms stand still, and slow motions of all arms together.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from armcell.cell.cell import Cell, with_geometry
from armcell.cell.live import LiveCell
from armcell.core import ArmcellError, CartesianRequest, InputError, JointGoal, JointState, PlanRequest
from armcell.core.gc_pauses import gc_frozen
from armcell.drivers.real import RobotIdentity, identify_all, kind_of, real_settings
from armcell.execution import execute
from armcell.kinematics import kinematic_tree
from armcell.planning import plan, plan_cartesian

SMALL = np.deg2rad(3.0)  # [rad] of the single joint motions
SLOW = 0.05  # velocity and acceleration scaling
LINE = 0.10  # [m]
LINE_TOLERANCE = 0.003  # [m] between the previewed and the measured line
ZERO_TOLERANCE = 0.02  # [m] between the tool position of the robot and of the cell's model

Confirm = Callable[[str, str], bool]
Tell = Callable[[str], None]


@dataclass(frozen=True)
class BringUpStep:
    """One step in the guided bring-up of a cell's real arms. The bring-up record stores the time and outcome
    of each step.
    """

    name: str
    arm: str
    wall: float  # [s] since the epoch
    outcome: str  # "done", "declined" or "failed"
    text: str


class BringUp:
    """Step-by-step bring-up of a cell's real arms.

    Args:
        confirm: called before each step with the step's name and a description; False ends the bring-up.
        tell: receives the result of each step.
        record: JSON file, written after every step.
    """

    def __init__(self, cell: Cell, confirm: Confirm, tell: Tell, record: Path | None = None):
        self.cell, self._confirm, self._tell, self._record = cell, confirm, tell, record
        try:
            self.settings = real_settings(cell.spec.real, cell.model)
        except InputError as error:
            raise InputError(error.reason, file=cell.file, element=error.element, hint=error.hint) from None
        self.steps: list[BringUpStep] = []
        self._found: dict[str, RobotIdentity] = {}

    def run(self) -> bool:
        """Run all steps of the cell's bring-up. Return False if the user declined a step or a step failed."""
        arms = self.settings.arms
        steps: list[tuple[str, str, str, Callable[[], str]]] = []
        for name, arm in arms.items():
            steps.append(("network", name, f"measures latency and jitter to {arm.host}; nothing moves",
                          lambda name=name: self._network(name)))  # fmt: skip
        steps.append(("identity", "all", "asks every robot who it is; nothing moves", self._identity))
        for name in arms:
            steps.append(("power", name, "powers the arm on and releases its brakes (they click, the arm may "
                          "sag a millimeter)", lambda name=name: self._power(name)))  # fmt: skip
        for name in arms:
            steps.append(("geometry", name, "compares the robot's tool pose with the cell's model; nothing "
                          "moves. Look: does the arm stand as in the viewer?",
                          lambda name=name: self._geometry(name)))  # fmt: skip
        if not self._all(steps):
            return False
        try:
            with self.cell.connect("real", watch=False) as live:
                steps = []
                for name in arms:
                    text = (
                        f"turns each joint by +{np.rad2deg(SMALL):.0f} degrees and back, at {SLOW:.0%} speed"
                    )
                    steps.append(("joints", name, f"{text}. Hand on the emergency stop",
                                  lambda name=name: self._joints(live, name)))  # fmt: skip
                for name in arms:
                    others = [n for n in arms if n != name]
                    still = f" while {', '.join(others)} stands still" if others else ""
                    steps.append(("line", name, f"moves the tool {LINE * 100:.0f} cm and back{still}, "
                                  "slowly, and compares with the preview",
                                  lambda name=name: self._line(live, name)))  # fmt: skip
                if len(arms) > 1:
                    steps.append(("together", "all", "moves all arms at the same time, slowly",
                                  lambda: self._together(live)))  # fmt: skip
                return self._all(steps)
        except ArmcellError as error:
            self._note("connect", "all", "failed", str(error))
            return False

    def _all(self, steps: list[tuple[str, str, str, Callable[[], str]]]) -> bool:
        for name, arm, text, act in steps:
            if not self._confirm(f"{name} ({arm})", text):
                self._note(name, arm, "declined", "")
                return False
            try:
                self._note(name, arm, "done", act())
            except ArmcellError as error:
                self._note(name, arm, "failed", str(error))
                return False
        return True

    def _note(self, name: str, arm: str, outcome: str, text: str) -> None:
        self.steps.append(BringUpStep(name, arm, time.time(), outcome, text))
        self._tell(f"{name} ({arm}): {outcome}" + (f": {text}" if text else ""))
        if self._record is not None:
            lines: list[dict[str, Any]] = [asdict(s) for s in self.steps]
            self._record.write_text(
                json.dumps({"cell": self.cell.name, "steps": lines}, indent=1) + "\n", encoding="utf-8"
            )

    # --- the steps ---
    def _network(self, name: str) -> str:
        arm = self.settings.arms[name]
        with gc_frozen():  # a pause of this program is not the network's
            report = kind_of(arm).measure_network(arm)
        if report.worst_gap > self.settings.max_state_age:
            raise InputError(
                f"{report}: a gap longer than {self.settings.max_state_age * 1000:.0f} ms would stop the arm",
                hint="a cable instead of WLAN, a switch of its own for the robots, no other load here",
            )
        return str(report)

    def _identity(self) -> str:
        arms = self.settings.arms
        self._found = identify_all(self.settings)
        results = []
        for name, found in self._found.items():
            kind_of(arms[name]).check_identity(name, arms[name], found)
            results.append(f"{name} is a {found}")
        unnamed = [
            f"{'serial' if found.serial else 'calibration'} of {name} ({found.serial or found.calibration})"
            for name, found in self._found.items()
            if (found.serial or found.calibration) and arms[name].serial is arms[name].calibration is None
        ]
        if unnamed:
            results.append(f"write {', '.join(unnamed)} into the cell file, so that arms cannot be swapped")
        return "; ".join(results)

    def _power(self, name: str) -> str:
        arm = self.settings.arms[name]
        return kind_of(arm).power_on(name, arm)

    def _geometry(self, name: str) -> str:
        """Compare the flange position from the robot's calibration with that from the cell's model,
        as a step of the bring-up.

        Both positions are computed for the same measured joint positions.

        Returns:
            The difference in words.
        Raises:
            InputError: the difference is above `ZERO_TOLERANCE`.
        """
        found, model, applied = self._found[name], self.cell.model, self.settings.calibration == "apply"
        if applied:
            model = with_geometry(model, self.settings, {name: found})
        arm = self.settings.arms[name]
        kind = kind_of(arm)
        q = kind.measured_positions(arm)
        group = model.group(name)
        state = self.cell.scene().positions.copy()
        state[model.columns(group.joint_names)] = q
        tree = kinematic_tree(model)
        base = model.joints[group.joint_names[0]].parent
        last = {model.joints[group.joint_names[-1]].child}
        for joint in model.joints.values():  # parents come first
            if not joint.movable and joint.parent in last:
                last.add(joint.child)
        theirs = kind.flange_position(found, q)
        # Models name the flange differently (tool0, ee_link): compare with the best-fitting fixed link.
        T_base_world = tree.link_pose(state, base).inverse()
        error = min(
            float(np.linalg.norm((T_base_world @ tree.link_pose(state, link)).translation - theirs))
            for link in last
        )
        if error > ZERO_TOLERANCE:
            raise InputError(
                f"the flange is {error * 1000:.0f} mm from where the cell's model has it",
                hint="wrong robot model in the cell, or a joint's zero is off (pendant: joint calibration)",
            )
        if applied:
            return f"flange {error * 1000:.2f} mm from the model with the robot's own calibration"
        text = f"flange {error * 1000:.1f} mm from the cell's nominal model"
        if not kind.calibrates:
            return text
        return f"{text} (factory calibration explains some; 'real: {{calibration: apply}}' plans with it)"

    def _joints(self, live: LiveCell, name: str) -> str:
        names = self.cell.model.group(name).joint_names
        moved = []
        for i, joint in enumerate(names):
            start = live.driver.joint_state().reindexed(names).positions
            sign = 1.0
            target = start.copy()
            target[i] += sign * SMALL
            self._go(live, name, target)
            seen = live.driver.joint_state().reindexed(names).positions - start
            if abs(seen[i] - SMALL) > 0.2 * SMALL or np.abs(np.delete(seen, i)).max() > 0.1 * SMALL:
                raise InputError(f"{joint}: {np.rad2deg(seen).round(2).tolist()} degrees were measured")
            moved.append(f"{joint} {np.rad2deg(seen[i]):+.2f}")
            self._go(live, name, start)
        return ", ".join(moved) + " degrees. Did each turn the way the viewer shows?"

    def _line(self, live: LiveCell, name: str) -> str:
        model = self.cell.model
        names, tip = model.group(name).joint_names, model.group(name).tip_link
        if tip is None:
            raise InputError(f"group {name!r} has no tip link", hint="name a chain in the robot's SRDF")
        now = live.scene()
        start = live.driver.joint_state().reindexed(names).positions
        pose = now.frame_pose(tip)
        reasons = []
        for shift in ((0, 0, LINE), (0, 0, -LINE), (0, LINE, 0), (0, -LINE, 0), (-LINE, 0, 0), (LINE, 0, 0)):
            request = CartesianRequest(
                name, (pose.shifted(*shift),), tip, velocity_scaling=SLOW, acceleration_scaling=SLOW
            )
            result = plan_cartesian(now, request)
            if result.ok and result.trajectory is not None:
                break
            reasons.append(result.message)
        else:
            raise InputError(
                f"no line of {LINE * 100:.0f} cm is free: {reasons[0]}", hint="move the arm by hand"
            )
        trajectory = result.trajectory
        worst = 0.0

        def look(_: float) -> None:
            nonlocal worst
            here = live.scene().frame_pose(tip).translation
            along = (here - pose.translation) @ np.array(shift) / LINE**2
            nearest = pose.translation + np.clip(along, 0, 1) * np.array(shift)
            worst = max(worst, float(np.linalg.norm(here - nearest)))

        done = execute(live.driver, live.ctx.gate.motion(trajectory), progress=look)
        if not done.ok:
            raise InputError(f"line: {done.message}")
        if worst > LINE_TOLERANCE:
            raise InputError(f"the tool was {worst * 1000:.1f} mm off the previewed line")
        self._go(live, name, start)
        return (
            f"at most {worst * 1000:.2f} mm off the previewed line, {done.max_tracking_error:.4f} rad behind"
        )

    def _together(self, live: LiveCell) -> str:
        arms = list(self.settings.arms)
        names = [n for arm in arms for n in self.cell.model.group(arm).joint_names]
        groups = [g.name for g in self.cell.model.groups.values() if set(g.joint_names) == set(names)]
        if not groups:
            return "the model has no group of all arms: skipped"
        start = live.driver.joint_state().reindexed(names).positions
        last = {self.cell.model.group(arm).joint_names[-1] for arm in arms}
        target = start + np.array([SMALL if name in last else 0.0 for name in names])
        for goal in (target, start):
            self._go(live, groups[0], goal, names)
        return "all arms moved and came back"

    def _go(self, live: LiveCell, group: str, q: np.ndarray, names=None) -> None:
        names = tuple(names or self.cell.model.group(group).joint_names)
        goal = JointGoal(JointState(names, q))
        result = plan(
            live.scene(), PlanRequest(group, (goal,), velocity_scaling=SLOW, acceleration_scaling=SLOW)
        )
        if not result.ok or result.trajectory is None:
            raise InputError(f"no plan: {result.message}", hint="is the scene as the cell file says?")
        done = execute(live.driver, live.ctx.gate.motion(result.trajectory))
        if not done.ok:
            raise InputError(f"motion failed: {done.message}")

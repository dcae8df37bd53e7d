"""Static check for common errors in rospy and moveit_commander scripts."""

from __future__ import annotations

import ast
import difflib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from armcell.core import InputError
from armcell.moveit.script_hints import CLASSES as TUTORIAL_CLASSES
from armcell.moveit.script_hints import METHODS as TUTORIAL_METHODS
from armcell.moveit.shims import moveit_commander
from armcell.ros.schema import schema

CLASSES = {
    "MoveGroupCommander": moveit_commander.MoveGroupCommander,
    "PlanningSceneInterface": moveit_commander.PlanningSceneInterface,
    "RobotCommander": moveit_commander.RobotCommander,
}
RETURN_NOTHING = ("set_joint_value_target", "set_pose_target", "set_pose_targets", "set_named_target",
                  "set_position_target", "set_orientation_target", "set_rpy_target")  # fmt: skip
SHARED = ("pose", "position", "orientation", "header", "point", "transform", "translation", "rotation")
SCALINGS = ("set_max_velocity_scaling_factor", "set_max_acceleration_scaling_factor")
MAX_BYTES = 5_000_000


@dataclass(frozen=True)
class Finding:
    """Problem that the linter finds in a ROS script: its line, its effect, and the code to write instead."""

    line: int
    rule: str
    text: str
    hint: str

    def describe(self, file: Path | str) -> str:
        return f"{file}:{self.line}: {self.rule}: {self.text} ({self.hint})"


Rule = Callable[["Script"], Iterator[Finding]]
RULES: list[Rule] = []


def rule(function: Rule) -> Rule:
    RULES.append(function)
    return function


def lint(file: Path) -> list[Finding]:
    """Lint the file of a ROS script and return the problems found, sorted by line.

    Raises:
        InputError: the file cannot be read, is too large, or is not UTF-8 text.
    """
    try:
        if file.stat().st_size > MAX_BYTES:
            raise InputError(f"is larger than {MAX_BYTES} bytes", file=file)
        text = file.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=file) from None
    except UnicodeDecodeError:
        raise InputError("is no text in UTF-8", file=file) from None
    return lint_text(text)


def lint_text(text: str) -> list[Finding]:
    """Lint the source text of a ROS script and return the problems found, sorted by line."""
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:  # last two: nested too deeply
        line = getattr(error, "lineno", None) or 1
        old = "print " in text and "print(" not in text
        hint = "Python 2: run 2to3 over it" if old else "Python 3 does not accept it"
        reason = getattr(error, "msg", str(error)) or "nested too deeply"
        return [Finding(line, "syntax", reason, hint)]
    script = Script(tree)
    found = {finding for each in RULES for finding in each(script)}
    return sorted(found, key=lambda f: (f.line, f.rule, f.text))


class Script:
    """ROS script parsed by the linter, with the names of those
    variables that hold plans or moveit_commander objects.
    """

    def __init__(self, tree: ast.Module):
        self.tree = tree
        self.nodes = list(ast.walk(tree))
        self.calls = [n for n in self.nodes if isinstance(n, ast.Call)]
        self.plans: dict[str, int] = {}  # variables that hold the whole tuple that plan() returns -> line
        self.objects: dict[str, str] = {}  # variable -> name of its moveit_commander class
        for node in self.nodes:
            if not isinstance(node, ast.Assign) or not isinstance(node.value, ast.Call):
                continue
            for target in node.targets:
                name = dotted(target)
                if not name:
                    continue
                called = method(node.value)
                if called in CLASSES:
                    self.objects[name] = called
                elif called == "plan" and isinstance(node.value.func, ast.Attribute):
                    self.plans[name] = node.lineno

    def conditions(self) -> Iterator[ast.expr]:
        """Yield the expressions that a linted ROS script uses as conditions (if, while, assert)."""
        for node in self.nodes:
            tests: list[ast.expr] = []
            if isinstance(node, ast.If | ast.While | ast.IfExp | ast.Assert):
                tests = [node.test]
            while tests:
                test = tests.pop()
                if isinstance(test, ast.BoolOp):
                    tests += test.values
                elif isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not):
                    tests.append(test.operand)
                else:
                    yield test

    def calls_of(self, *names: str) -> Iterator[ast.Call]:
        """Yield the calls in a linted ROS script whose method has one of the given names."""
        return (c for c in self.calls if isinstance(c.func, ast.Attribute) and c.func.attr in names)

    def uses(self, name: str) -> bool:
        return any(method(c) == name for c in self.calls)


def dotted(node: ast.AST) -> str:
    """Return a name or attribute chain in a linted script as text, e.g. `self.a.b`.
    The text is empty for any other expression.
    """
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        inner = dotted(node.value)
        return f"{inner}.{node.attr}" if inner else ""
    return ""


def method(call: ast.Call) -> str:
    """Return the name of the function or method that a linted script calls, without the object before the
    dot.
    """
    return call.func.attr if isinstance(call.func, ast.Attribute) else dotted(call.func)


def number(node: ast.AST) -> float | None:
    """Return the signed value of a number literal in a linted script, or None."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        inner = number(node.operand)
        return None if inner is None else -inner
    if (
        isinstance(node, ast.Constant)
        and isinstance(node.value, int | float)
        and not isinstance(node.value, bool)
    ):
        return float(node.value)
    return None


@rule
def jump_threshold(script: Script) -> Iterator[Finding]:
    for call in script.calls_of("compute_cartesian_path"):
        if len(call.args) > 2 and number(call.args[2]) is not None:
            value = ast.unparse(call.args[2])
            yield Finding(
                call.lineno, "jump-threshold",
                f"the third argument {value} was jump_threshold up to MoveIt 1.1.14; since then it is "
                f"avoid_collisions{', which 0 switches off' if number(call.args[2]) == 0 else ''}",
                "armcell takes a number as jump_threshold; write avoid_collisions=True",
            )  # fmt: skip


@rule
def plan_is_a_tuple(script: Script) -> Iterator[Finding]:
    for test in script.conditions():
        if dotted(test) in script.plans:
            yield Finding(
                test.lineno, "plan-tuple",
                f"`{dotted(test)}` is the tuple (success, trajectory, time, error_code): always true",
                f"test {dotted(test)}[0], or write: success, trajectory, _, _ = group.plan()",
            )  # fmt: skip
    for call in script.calls_of("execute"):
        if call.args and dotted(call.args[0]) in script.plans:
            name = dotted(call.args[0])
            yield Finding(
                call.lineno, "plan-tuple",
                f"execute({name}) gets the whole tuple of plan(), MoveIt wants a trajectory",
                f"write execute({name}[1]); armcell takes the trajectory out",
            )  # fmt: skip


@rule
def nothing_returned(script: Script) -> Iterator[Finding]:
    for test in script.conditions():
        if isinstance(test, ast.Call) and method(test) in RETURN_NOTHING:
            yield Finding(
                test.lineno, "returns-none", f"{method(test)}() returns None, which is false",
                "it raises MoveItCommanderException where the target cannot be: use try",
            )  # fmt: skip


@rule
def shared_pose(script: Script) -> Iterator[Finding]:
    changed = any(
        isinstance(n, ast.AugAssign) and isinstance(n.target, ast.Attribute) and n.target.attr in "xyzw"
        for n in script.nodes
    )
    if not changed:
        return
    for node in script.nodes:
        if not isinstance(node, ast.Assign) or not isinstance(node.value, ast.Name | ast.Attribute):
            continue
        for target in node.targets:
            shared = isinstance(target, ast.Attribute) and target.attr in SHARED
            source = dotted(node.value)
            last = source.rpartition(".")[2]
            if shared and source and (last in SHARED or last.endswith("pose")):
                yield Finding(
                    node.lineno, "shared-pose",
                    f"{dotted(target)} and {source} are one object from here on: adding to one changes the "
                    "other, and offsets add up",
                    f"write copy.deepcopy({source})",
                )  # fmt: skip


@rule
def no_such_name(script: Script) -> Iterator[Finding]:
    for node in script.nodes:
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from _imports(node)
    for call in script.calls:
        if not isinstance(call.func, ast.Attribute):
            continue
        owner = script.objects.get(dotted(call.func.value))
        if owner == "MoveGroupCommander" and call.func.attr in TUTORIAL_METHODS:
            yield Finding(
                call.lineno, "no-such-name", f"MoveIt's {owner} has no method {call.func.attr}",
                f"{TUTORIAL_METHODS[call.func.attr]}; armcell accepts the call",
            )  # fmt: skip
        elif owner and not hasattr(CLASSES[owner], call.func.attr) and owner != "RobotCommander":
            yield Finding(
                call.lineno, "no-such-name", f"{owner} has no method {call.func.attr}",
                _nearest(call.func.attr, [n for n in dir(CLASSES[owner]) if not n.startswith("_")]),
            )  # fmt: skip


def _imports(node: ast.ImportFrom) -> Iterator[Finding]:
    package, _, kind = (node.module or "").partition(".")
    known = schema()
    packages = {n.split("/")[0] for n in known.messages}
    for alias in node.names:
        name, full = alias.name, f"{package}/{alias.name}"
        if name == "*":
            continue
        if kind == "msg" and package in packages and full not in known.definitions:
            hint = _nearest(name, [n.split("/")[1] for n in known.messages if n.startswith(f"{package}/")])
            if full in known.services:
                hint = f"it is a service: from {package}.srv import {name}"
            yield Finding(node.lineno, "no-such-name", f"{package}.msg has no {name}", hint)
        elif node.module == "moveit_commander" and name in TUTORIAL_CLASSES:
            yield Finding(
                node.lineno, "no-such-name", f"moveit_commander has no {name}",
                f"{TUTORIAL_CLASSES[name]}; armcell accepts it",
            )  # fmt: skip
        elif node.module == "moveit_commander" and not hasattr(moveit_commander, name):
            yield Finding(
                node.lineno, "no-such-name", f"moveit_commander has no {name}",
                _nearest(name, list(moveit_commander.__all__)),
            )  # fmt: skip


def _nearest(name: str, known: list[str]) -> str:
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    return f"did you mean {' or '.join(near)}?" if near else "it never existed in MoveIt 1"


AT_ONCE = {
    "execute": (
        "stock MoveIt pre-empts or serialises motions that overlap, also of different arms",
        "armcell moves both where that is proven free of contact; MoveIt needs one group of both",
    ),
    "go": (
        "any newer go() or plan() ends this motion, also one of another arm's group",
        "plan each, then execute(trajectory, wait=False): armcell moves both where that is proven free",
    ),
}


@rule
def not_waited_for(script: Script) -> Iterator[Finding]:
    for name, (text, hint) in AT_ONCE.items():
        for call in script.calls_of(name):
            waits = next((k.value for k in call.keywords if k.arg == "wait"), None)
            if isinstance(waits, ast.Constant) and waits.value is False:
                yield Finding(call.lineno, "two-at-once", text, hint)


@rule
def degrees(script: Script) -> Iterator[Finding]:
    for call in script.calls_of("go", "set_joint_value_target", "set_rpy_target", "remember_joint_values"):
        lists = [a for a in call.args if isinstance(a, ast.List | ast.Tuple)]
        values = [number(e) for item in lists for e in item.elts]
        values += [number(a) for a in call.args[1:2]] if method(call) == "set_joint_value_target" else []
        yield from _large(call, values)
    for call in script.calls:
        if method(call) == "quaternion_from_euler":
            yield from _large(call, [number(a) for a in call.args[:3]])


def _large(call: ast.Call, values: list[float | None]) -> Iterator[Finding]:
    large = [v for v in values if v is not None and abs(v) > 2 * math.pi + 0.01]
    if large:
        yield Finding(
            call.lineno, "degrees", f"{large[0]:g} is more than a turn: angles are radians",
            f"write math.radians({large[0]:g})",
        )  # fmt: skip


@rule
def wall_clock(script: Script) -> Iterator[Finding]:
    rospy = any(isinstance(n, ast.Import) and any(a.name == "rospy" for a in n.names) for n in script.nodes)
    for call in script.calls:
        name = dotted(call.func)
        if rospy and name in ("time.sleep", "time.time"):
            other = "rospy.sleep" if name == "time.sleep" else "rospy.get_time"
            yield Finding(
                call.lineno, "wall-clock", f"{name}() is the wall's clock, the simulation has its own",
                f"write {other}()",
            )  # fmt: skip


@rule
def guessed_wait(script: Script) -> Iterator[Finding]:
    for function in (n for n in script.nodes if isinstance(n, ast.FunctionDef)):
        inner = [n for n in ast.walk(function) if isinstance(n, ast.Call)]
        timed = any(isinstance(n, ast.Attribute) and n.attr == "time_from_start" for n in ast.walk(function))
        for call in inner:
            if timed and dotted(call.func) in ("rospy.sleep", "time.sleep"):
                yield Finding(
                    call.lineno, "guessed-wait",
                    "waits for the time that the motion should take, not for its end",
                    "use group.execute(), the follow_joint_trajectory action, or /trajectory_status",
                )  # fmt: skip


@rule
def scaling(script: Script) -> Iterator[Finding]:
    for call in script.calls_of(*SCALINGS):
        value = number(call.args[0]) if call.args else None
        if value is not None and not 0 < value <= 1:
            yield Finding(
                call.lineno, "scaling", f"a scaling of {value:g} raises MoveItCommanderException",
                "give a number above 0, at most 1",
            )  # fmt: skip
    moved = [c for c in script.calls_of("go", "plan") if dotted(c.func.value) in script.objects]  # type: ignore[attr-defined]
    if moved and not any(True for _ in script.calls_of(*SCALINGS)):
        yield Finding(
            min(c.lineno for c in moved), "slow",
            "no scaling is set: MoveIt moves at a tenth of the limits since Noetic",
            "set_max_velocity_scaling_factor(0.5), set_max_acceleration_scaling_factor(0.5)",
        )  # fmt: skip


@rule
def no_node(script: Script) -> Iterator[Finding]:
    first = [n.lineno for n in script.calls if method(n) in CLASSES]
    if first and not script.uses("init_node"):
        yield Finding(
            min(first), "no-node", "there is no rospy.init_node: with ROS nothing is received",
            "call rospy.init_node('my_script') first",
        )  # fmt: skip


@rule
def no_gripper(script: Script) -> Iterator[Finding]:
    if commands_gripper(script):
        return
    for call in script.calls:
        if dotted(call.func).startswith("rospy.log") and call.args:
            text = call.args[0].value if isinstance(call.args[0], ast.Constant) else ""
            if isinstance(text, str) and "close" in text.lower() and "gripper" in text.lower():
                yield Finding(
                    call.lineno, "no-gripper", "a log line closes no gripper",
                    "publish to /gripper_command, or run it with --auto-grip",
                )  # fmt: skip


def commands_gripper(script: Script) -> bool:
    """Return whether a ROS script that the linter has parsed commands a gripper itself."""
    words = [n.value for n in script.nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    names = ("gripper_command", "gripper_cmd", "gripper_controller", "hand_controller", "franka_gripper")
    if any(name in word for word in words for name in names):
        return True
    groups = [c for c in script.calls if method(c) == "MoveGroupCommander" and c.args]
    given = [c.args[0].value for c in groups if isinstance(c.args[0], ast.Constant)]
    if any(isinstance(g, str) and ("gripper" in g or "hand" in g) for g in given):
        return True
    return any(True for _ in script.calls_of("pick", "place"))


def closes_gripper_itself(file: Path) -> bool:
    """Return whether the ROS script in a file commands a gripper itself, according to the linter. If the file
    cannot be parsed, return True.
    """
    try:
        return commands_gripper(Script(ast.parse(file.read_text(encoding="utf-8"))))
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return True

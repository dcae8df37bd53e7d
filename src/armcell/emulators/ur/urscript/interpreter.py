"""URScript interpreter: compiler to Python generators, execution of threads, lists and poses.

Generators yield every control step; all threads run in turn up to the next one. Lists and poses are copied
by assignment; their arithmetic is item by item.

A script reaches Python only through the node types here: variable names get a prefix, and constants are
written by `repr`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterable, Mapping
from functools import partial
from types import CodeType
from typing import Any

from armcell.core import ArmcellError
from armcell.emulators.ur.urscript.parser import Node, ScriptError, parse

_NOT_EMULATED = """
    rpc_factory modbus_add_signal modbus_add_rtu_signal modbus_delete_signal modbus_get_signal_status
    modbus_get_signal_index modbus_get_error_count modbus_get_time_since_signal_invalid
    modbus_reset_connection modbus_send_custom_command modbus_set_output_register modbus_set_output_signal
    modbus_set_runstate_dependent_choice modbus_set_signal_update_frequency modbus_set_signal_watchdog
    modbus_set_digital_input_action
    track_conveyor_linear track_conveyor_circular stop_conveyor_tracking conveyor_pulse_decode
    get_conveyor_tick_count set_conveyor_tick_count encoder_enable_pulse_decode encoder_enable_set_tick_count
    encoder_get_tick_count encoder_set_tick_count encoder_unwind_delta_tick_count path_offset_enable
    path_offset_disable path_offset_set path_offset_get path_offset_set_alpha_filter
    path_offset_set_max_offset screw_driving end_screw_driving
    set_tool_communication reset_world_model add_frame attach_frame
    convert_pose delete_frame frame_exists get_frame_children get_pose get_root_frames move_frame
    request_boolean_from_primary_client request_float_from_primary_client
    request_integer_from_primary_client request_string_from_primary_client
    read_port_bit read_port_register write_port_bit write_port_register
    set_runstate_configurable_digital_output_to_value
    set_runstate_standard_analog_output_to_value set_runstate_standard_digital_output_to_value
    set_runstate_tool_digital_output_to_value set_runstate_gp_boolean_output_to_value
    set_euromap_output set_euromap_runstate_dependent_choice get_euromap_input get_euromap_output
    set_safety_mode_transition_hardness position_deviation_warning reset_revolution_counter
    tool_wrench_limit_set tool_wrench_limit_disable calculate_inertia_tensor collision_detection_set
    collision_detection_disable
"""
NOT_EMULATED = frozenset(_NOT_EMULATED.split())
"""Functions of real controllers that compile, but end the program with an error when called."""
log = logging.getLogger(__name__)
Thread = Generator[None, None, Any]
MAX_TURNS = 20_000  # largest number of loop iterations between two control steps


class Vec(list):
    """URScript value in the interpreter that is a list with item-by-item arithmetic."""

    def _by_item(self, other: Any, act: Callable[[Any, Any], Any]) -> Vec:
        if isinstance(other, list):
            if len(other) != len(self):
                raise TypeError(f"lists of {len(self)} and {len(other)} items do not fit")
            return type(self)(act(a, b) for a, b in zip(self, other))
        return type(self)(act(a, other) for a in self)

    def __add__(self, other: Any) -> Vec:  # type: ignore[override]
        return self._by_item(other, lambda a, b: a + b)

    def __radd__(self, other: Any) -> Vec:
        return self._by_item(other, lambda a, b: b + a)

    def __sub__(self, other: Any) -> Vec:
        return self._by_item(other, lambda a, b: a - b)

    def __rsub__(self, other: Any) -> Vec:
        return self._by_item(other, lambda a, b: b - a)

    def __mul__(self, other: Any) -> Vec:  # type: ignore[override]
        return self._by_item(other, lambda a, b: a * b)

    __rmul__ = __mul__  # type: ignore[assignment]

    def __truediv__(self, other: Any) -> Vec:
        return self._by_item(other, lambda a, b: a / b)

    def __neg__(self) -> Vec:
        return type(self)(-a for a in self)


class Pose(Vec):
    """URScript value in the interpreter for a pose p[x, y, z, rx, ry, rz], which consists of a position [m]
    and a rotation vector [rad].
    """


def copy_value(value: Any) -> Any:
    """Copy a value that the interpreter assigns to a URScript variable. Lists and poses are copied; other
    values are returned unchanged.
    """
    if isinstance(value, Vec):
        return type(value)(copy_value(v) for v in value)
    return value


def format_value(value: Any) -> str:
    if isinstance(value, Pose):
        return "p[" + ", ".join(format_value(v) for v in value) + "]"
    if isinstance(value, list):
        return "[" + ", ".join(format_value(v) for v in value) + "]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


class _Scope:
    def __init__(self, names: set[str] | None):
        self.local = names  # None: the program's body, whose variables are global


def compile_script(
    statements: list[Node], blocking: Iterable[str], instant: Mapping[str, Callable[..., Any]]
) -> CodeType:
    """Compile the syntax tree of a URScript text for the interpreter: to Python code that defines a generator
    `main(G, F, B, I, M)`.

    Args:
        blocking: names of functions that take time, called as `B[name](...)`.
        instant: functions that return immediately, called as `I[name](...)`.
    """
    return compile(_Compiler(blocking, instant).source(statements), "<urscript>", "exec")


class _Compiler:
    def __init__(self, blocking: Iterable[str], instant: Mapping[str, Callable[..., Any]]):
        self._blocking, self._instant = frozenset(blocking), frozenset(instant)
        self._lines: list[str] = []
        self._globals: set[str] = set()
        self._functions: dict[str, str] = {}

    def source(self, statements: list[Node]) -> str:
        self._find(statements, top=True)
        self._emit(0, "def main(G, F, B, I, M):")
        functions: list[Node] = []
        self._take_functions(statements, functions)
        for node in functions:
            self._function(node)
        self._body(statements, 1, _Scope(None))
        self._emit(1, "return")
        self._emit(1, "yield")
        return "\n".join(self._lines)

    def _emit(self, depth: int, text: str) -> None:
        self._lines.append("  " * depth + text)

    def _find(self, statements: list[Node], top: bool) -> None:
        """Collect the global names in a URScript text for the interpreter's compiler: those declared as
        global, or assigned in the body.
        """
        for node in statements:
            if node[0] == "assign" and node[1][0] == "name" and (node[3] == "global" or top):
                self._globals.add(node[1][1])
            elif node[0] == "if":
                for _, body in node[1]:
                    self._find(body, top)
            elif node[0] == "while":
                self._find(node[2], top)
            elif node[0] == "def":
                self._functions[node[2]] = node[1]
                self._find(node[4], False)

    def _take_functions(self, statements: list[Node], found: list[Node]) -> None:
        for node in statements:
            if node[0] == "def":
                found.append(node)
                self._take_functions(node[4], found)
            elif node[0] == "if":
                for _, body in node[1]:
                    self._take_functions(body, found)
            elif node[0] == "while":
                self._take_functions(node[2], found)

    def _function(self, node: Node) -> None:
        _, _, name, parameters, body, _ = node
        names = {p for p, _ in parameters}
        locals_: set[str] = set(names)
        self._find_locals(body, locals_)
        scope = _Scope(locals_)
        given = ", ".join(
            f"v_{p}" + ("" if default is None else f"={self._value(default, _Scope(None))}")
            for p, default in parameters
        )
        self._emit(1, f"def u_{name}({given}):")
        for variable in sorted(locals_ - names):
            self._emit(2, f"v_{variable} = None")
        self._body(body, 2, scope)
        self._emit(2, "return None")
        self._emit(2, "yield")
        self._emit(1, f"F[{name!r}] = u_{name}")

    def _find_locals(self, statements: list[Node], found: set[str]) -> None:
        for node in statements:
            if node[0] == "assign" and node[1][0] == "name":
                name = node[1][1]
                if node[3] == "local" or (node[3] == "" and name not in self._globals):
                    found.add(name)
            elif node[0] == "if":
                for _, body in node[1]:
                    self._find_locals(body, found)
            elif node[0] == "while":
                self._find_locals(node[2], found)

    def _body(self, statements: list[Node], depth: int, scope: _Scope) -> None:
        self._emit(depth, "pass")
        for node in statements:
            kind, line = node[0], node[-1]
            if kind == "def":
                continue
            if kind not in ("break", "continue"):
                self._emit(depth, f"M.line = {line}")
            if kind == "assign":
                self._emit(depth, f"{self._target(node[1], scope)} = copied({self._value(node[2], scope)})")
            elif kind == "do":
                self._emit(depth, self._value(node[1], scope))
            elif kind == "if":
                for i, (condition, body) in enumerate(node[1]):
                    word = "if" if i == 0 else "elif"
                    head = "else:" if condition is None else f"{word} {self._value(condition, scope)}:"
                    self._emit(depth, head)
                    self._body(body, depth + 1, scope)
            elif kind == "while":
                self._emit(depth, f"while {self._value(node[1], scope)}:")
                self._emit(depth + 1, "M.count()")
                self._body(node[2], depth + 1, scope)
            elif kind == "return":
                self._emit(depth, f"return {'None' if node[1] is None else self._value(node[1], scope)}")
            elif kind in ("break", "continue"):
                self._emit(depth, kind)
            elif kind == "halt":
                self._emit(depth, "M.halt(); yield")
            elif kind == "kill":
                self._emit(depth, f"M.kill({self._value(node[1], scope)})")
            elif kind == "join":
                self._emit(depth, f"yield from M.join({self._value(node[1], scope)})")

    def _target(self, node: Node, scope: _Scope) -> str:
        if node[0] == "index":
            return f"{self._target(node[1], scope)}[{self._value(node[2], scope)}]"
        if node[0] != "name":
            raise ScriptError(
                "only a variable or its item can be assigned", node[-1] if isinstance(node[-1], int) else 0
            )
        return self._name(node[1], scope)

    def _name(self, name: str, scope: _Scope) -> str:
        if scope.local is not None and name in scope.local:
            return f"v_{name}"
        return f"G[{name!r}]"

    def _value(self, node: Node, scope: _Scope) -> str:
        kind = node[0]
        if kind == "const":
            return repr(node[1])
        if kind == "name":
            return self._name(node[1], scope)
        if kind in ("list", "pose"):
            items = ", ".join(self._value(v, scope) for v in node[1])
            return f"{'Vec' if kind == 'list' else 'Pose'}(({items}{',' if node[1] else ''}))"
        if kind == "index":
            return f"{self._value(node[1], scope)}[{self._value(node[2], scope)}]"
        if kind == "neg":
            return f"(-{self._value(node[1], scope)})"
        if kind == "not":
            return f"(not {self._value(node[1], scope)})"
        if kind == "op":
            sign, left, right = node[1], self._value(node[2], scope), self._value(node[3], scope)
            if sign == "xor":
                return f"(bool({left}) != bool({right}))"
            return f"({left} {sign} {right})"
        if kind == "run":
            _, name, arguments, place = node[1]
            self._known(name, place)
            return f"M.spawn(u_{name}({self._arguments(arguments, scope, 'v_')}))"
        return self._call(node, scope)

    def _call(self, node: Node, scope: _Scope) -> str:
        _, name, arguments, place = node
        if name in self._functions:
            return f"(yield from u_{name}({self._arguments(arguments, scope, 'v_')}))"
        given = self._arguments(arguments, scope)
        if name in self._blocking:
            return f"(yield from B[{name!r}]({given}))"
        if name in self._instant:
            return f"I[{name!r}]({given})"
        if name in NOT_EMULATED:
            # Not emulated: reported only when the program calls it.
            return f"M.fail_unknown_function({name!r})"
        raise _not_found(name, place)

    def _arguments(self, arguments: list[tuple[str | None, Node]], scope: _Scope, prefix: str = "") -> str:
        return ", ".join(
            (f"{prefix}{keyword}=" if keyword else "") + self._value(value, scope)
            for keyword, value in arguments
        )

    def _known(self, name: str, place: tuple[int, int]) -> None:
        if name not in self._functions:
            raise _not_found(name, place)


def _not_found(name: str, place: tuple[int, int]) -> ScriptError:
    line, column = place
    reason = f"function {name!r} is not known to this controller"
    return ScriptError(reason, line, column, code=f"compile_error_name_not_found:{name}:")


class ProgramError(ArmcellError):
    """Runtime error in the URScript interpreter, which stops the program.

    Attributes:
        line: line in the script's text, from 1.
    """

    def __init__(self, reason: str, line: int = 0):
        self.line = line
        super().__init__(f"line {line}: {reason}" if line else reason)


class _Halt(Exception):
    pass


def _takes_time(name: str, *_: Any, **__: Any) -> Thread:
    raise ProgramError(f"{name} takes time, which a secondary program must not")


class Machine:
    """Interpreter machine that runs a compiled URScript program with its threads and variables.

    If the script consists of a single function definition without parameters, that function is the program
    (as on UR's controllers); otherwise the statements of the script are.

    Attributes:
        secondary: True for a `sec` program, which runs next to the main program and must not take time.
        line: line that is being executed, from 1.
    """

    def __init__(
        self,
        text: str,
        blocking: Mapping[str, Callable[..., Thread]],
        instant: Mapping[str, Callable[..., Any]],
    ):
        statements = parse(text)
        self.name = "unnamed"
        self.secondary = len(statements) == 1 and statements[0][0] == "def" and statements[0][1] == "sec"
        if len(statements) == 1 and statements[0][0] == "def" and not statements[0][3]:
            self.name = statements[0][2]
            statements = statements[0][4]
        if self.secondary:
            blocking = {name: partial(_takes_time, name) for name in blocking}
        code = compile_script(statements, blocking, instant)
        space: dict[str, Any] = {
            "Vec": Vec, "Pose": Pose, "copied": copy_value, "bool": bool, "__builtins__": {},
        }  # fmt: skip
        exec(code, space)  # safe: the code comes from compiler.py, and script names cannot reach Python names
        self.line = 0
        self._turns = 0
        self.variables: dict[str, Any] = {}
        self._threads: dict[int, Thread] = {1: space["main"](self.variables, {}, blocking, instant, self)}
        self._next, self.running = 2, True

    def step(self) -> None:
        """Run every thread of the program in the URScript interpreter up to its next control step.

        Raises:
            ProgramError: a runtime error, with its line.
        """
        for key in list(self._threads):
            thread = self._threads.get(key)
            if thread is None:
                continue
            self._turns = 0
            try:
                next(thread)
            except StopIteration:
                self._threads.pop(key, None)
            except _Halt:
                self._threads.clear()
            except ProgramError as error:
                raise (error if error.line else ProgramError(str(error), self.line)) from None
            except KeyError as error:
                raise ProgramError(f"variable {error.args[0]!r} has no value", self.line) from None
            except Exception as error:  # no program error may stop the controller
                raise ProgramError(str(error), self.line) from None
            if 1 not in self._threads:  # the program ends with its main thread
                break
        self.running = 1 in self._threads
        if not self.running:
            self._threads.clear()

    # --- called by compiled code ---
    def count(self) -> None:
        self._turns += 1
        if self._turns > MAX_TURNS:
            raise ProgramError("a loop without a wait (add sync() or sleep())", self.line)

    def spawn(self, thread: Thread) -> int:
        if len(self._threads) > 50:
            raise ProgramError("more than 50 threads", self.line)
        key = self._next
        self._next += 1
        self._threads[key] = thread
        return key

    def kill(self, key: Any) -> None:
        if key != 1:
            thread = self._threads.pop(key, None)
            if thread is not None and not thread.gi_running:  # type: ignore[attr-defined]
                thread.close()

    def join(self, key: Any) -> Thread:
        while key in self._threads:
            yield

    def halt(self) -> None:
        raise _Halt

    def fail_unknown_function(self, name: str) -> None:
        raise ProgramError(f"this emulator does not have the function {name!r}", self.line)

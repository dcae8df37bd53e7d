"""URScript's interpreter against what UR's manual says a program does, and against Python's arithmetic."""

import random

import pytest

from armcell.drivers.ur.wire.models import ur_model
from armcell.emulators.ur.builtins_data import io_functions
from armcell.emulators.ur.plant import KinematicPlant
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.script_server import StateEncoder
from armcell.emulators.ur.urscript import Machine, ProgramError, ScriptError, parse


def run(text: str, steps: int = 1000, **functions):
    def sync():
        yield

    machine = Machine(text, {"sync": sync}, functions)
    for _ in range(steps):
        if not machine.running:
            break
        machine.step()
    return machine


def test_expressions_are_python_s():
    rng = random.Random(3)
    for _ in range(200):
        parts = [rng.choice(["3", "2.5", "(1+2)", "-4", "0x1F"])]
        for _ in range(rng.randint(1, 6)):
            parts += [
                rng.choice([" + ", " - ", " * ", " / ", " % "]),
                rng.choice(["7", "1.5", "(2 - 5)", "-3"]),
            ]
        text = "".join(parts)
        assert run(f"x = {text}\n").variables["x"] == pytest.approx(eval(text)), text


def test_lists_are_copied_and_added_by_item():
    v = run("a = [1, 2]\nb = a\nb[0] = 9\nc = a + b * 2\nd = -a / 2\n").variables
    assert v["a"] == [1, 2] and v["b"] == [9, 2] and v["c"] == [19, 6] and v["d"] == [-0.5, -1.0]


def test_threads_share_globals_and_can_be_killed():
    text = """
def program():
  global ticks = 0
  thread clock():
    while True:
      ticks = ticks + 1
      sync()
    end
  end
  def wait_for(n, more=1):
    local end_ = ticks + n + more
    while ticks < end_:
      sync()
    end
    return end_
  end
  handle = run clock()
  last = wait_for(3, more=2)
  kill handle
  sync()
  sync()
end
"""
    machine = run(text)
    assert not machine.running and machine.name == "program"
    assert machine.variables["last"] == machine.variables["ticks"] == 5


def test_what_ur_rtde_s_script_does_with_lines():
    """A value on the next line, and two statements on one."""
    v = run(
        "global a = # offset\n0    global b = 2\ndef f(p): \n p[0] = 5\n return p[0]\n end\nc = f([1])\n"
    ).variables
    assert (v["a"], v["b"], v["c"]) == (0, 2, 5)


def test_halt_ends_the_program():
    machine = run("x = 1\nhalt\nx = 2\n")
    assert machine.variables["x"] == 1 and not machine.running


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("def f():\n x = 1\n", "line 3: expected 'end'"),
        ("x = = 2\n", "line 1: expected a value"),
        ("x = 1 ?\n", "'?'"),
        ("f(1) = 2\n", "can be given a value"),
        ("x = p[1, 2]\n", "six numbers"),
        ("run 5\n", "thread's call"),
        ("(" * 100 + "1" + ")" * 100 + "\n", "nested too deeply"),
    ],
)
def test_what_is_no_urscript_is_said_with_its_line(text, reason):
    with pytest.raises(ScriptError, match=reason.replace("?", r"\?").replace("(", r"\(")):
        parse(text)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("while True:\nend\n", "line 1: a loop without a wait"),
        ("x = y\n", "variable 'y' has no value"),
        ("x = [1]\nz = x[3]\n", "line 2"),
        ("x = 1 / 0\n", "division"),
        ("modbus_add_signal()\n", "line 1: this emulator does not have the function 'modbus_add_signal'"),
    ],
)
def test_runtime_errors_name_the_line(text, reason):
    with pytest.raises(ProgramError, match=reason):
        run(text)


def test_an_unknown_function_is_found_before_the_program_starts_as_on_a_controller():
    text = "def f():\n  x = 1\n  if x > 2:\n    y = 2 + open_door(x)\n  end\nend\n"
    with pytest.raises(ScriptError, match="line 4: function 'open_door' is not known") as found:
        run(text)
    error = found.value
    assert (error.line, error.column, error.code) == (4, 13, "compile_error_name_not_found:open_door:")


def test_a_secondary_program_must_not_take_time():
    machine = Machine("sec act():\n  out(3)\nend\n", {"sync": list}, {"out": lambda x: None})
    assert machine.secondary
    machine.step()
    assert not machine.running
    with pytest.raises(ProgramError, match="sync takes time"):
        Machine("sec act():\n  sync()\nend\n", {"sync": list}, {}).step()


@pytest.mark.parametrize("name", ["__import__", "exec", "M", "G", "open", "__builtins__"])
def test_a_script_cannot_reach_python(name):
    with pytest.raises(ScriptError, match="not known"):
        run(f'x = {name}("os")\n')
    with pytest.raises(ProgramError, match="has no value"):
        run(f"x = {name}\n")


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("set_tool_voltage(99999999999999999999)", "0, 12 or 24 V"),
        ("write_output_integer_register(0, 99999999999)", "32 bits"),
        ("write_output_integer_register(48, 1)", "no register 48"),
        ("write_output_float_register(-1, 1.0)", "no register -1"),
        ("x = read_output_integer_register(99)", "no register 99"),
    ],
)
def test_a_value_that_no_packet_can_hold_ends_the_program(line, reason):
    robot = Robot(ur_model("UR10e"), KinematicPlant([0.0, -1.5, 1.5, -1.5, -1.5, 0.0]), "1")
    with pytest.raises(ProgramError, match=reason):
        run(line + "\n", **io_functions(robot))
    assert robot.tool_voltage == 0 and not any(robot.output_int)
    StateEncoder(robot).primary()

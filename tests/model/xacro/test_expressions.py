"""Expressions of xacro files: what they may compute, and that they can do nothing else."""

from __future__ import annotations

import ast
import builtins
import math
import string
import time

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from armcell.model.xacro.budget import Budget, XacroError, size
from armcell.model.xacro.expressions import AttributeDict, NameSpace, evaluate
from armcell.model.xacro.functions import BASIC, MATH, PYTHON, text_of

LIMITS = AttributeDict(lower=-1.5, upper=2, names=["a", "b"], origin=AttributeDict(xyz="0 0 1"))
NAMES = NameSpace(
    {
        **MATH, **BASIC, "python": NameSpace(PYTHON), "math": NameSpace(MATH), "x": 3, "word": "left arm",
        "limits": LIMITS, "true": True, "template": "{0.__class__}", "items": "{0[0]}",
        "wide": "{:>9999999999}",
    }
)  # fmt: skip


def value(text: str, steps: int = 2_000_000):
    return evaluate(text, NAMES, Budget(steps))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1./12 * 2 * (3 * 0.1**2 + 0.4**2)", 1 / 12 * 2 * (3 * 0.1**2 + 0.4**2)),
        ("-pi/2 if x == 3 else 0", -math.pi / 2),
        ("'left_' + word.split(' ')[1]", "left_arm"),
        ("limits.lower + limits['upper']", 0.5),
        ("limits.origin.xyz.split()[2]", "1"),
        ("'lower' in limits and 'mass' not in limits", True),
        ("[2 * i for i in [1, 2, 3] if i != 2]", [2, 6]),
        ("{k: v for k, v in python.zip('ab', [1, 2])}", {"a": 1, "b": 2}),
        ("[a + b for a in 'xy' for b in 'pq']", ["xp", "xq", "yp", "yq"]),
        ("dict(a=1, b=[2, 3])['b'][-1]", 3),
        ("list(map(float, '1 2.5'.split(' ')))", [1.0, 2.5]),
        ("max(limits.names + ['left'], key=len)", "left"),
        ("sorted([3, 1, 2], reverse=True)[:2]", [3, 2]),
        ("'%.3f, %s' % (pi, 'm')", "3.142, m"),
        ("'/'.join(limits.names)", "a/b"),
        ("round(math.degrees(radians(30)), 6)", 30.0),
        ("python.isinstance(x, python.int) or python.isinstance(word, (str, list))", True),
        ("python.sum([i * i for i in range(4)])", 14),
        ("(1 << 4) | 3 & ~2, 7 // 2 % 2", (17, 1)),
        ("word[::-1].upper()", "MRA TFEL"),
        ("len(word) > 3 and not '' or None", True),
    ],
)
def test_expressions_of_robot_descriptions(text, expected):
    assert value(text) == expected and type(value(text)) is type(expected)


ATTACKS = [
    "(lambda: 1)()", "__import__('os').system('true')", "open('/etc/passwd')", "eval('1')", "exec('1')",
    "[].__class__", "().__class__.__bases__[0].__subclasses__()", "''.join.__globals__", "len.__self__",
    "''.__class__.__mro__[1]", "x.__class__", "True.real", "limits.__class__", "limits.__dict__",
    "limits.update", "limits.pop('lower')", "[1].append(2)", "limits.fromkeys([1])", "math.__dict__",
    "math.__loader__", "python.__class__", "python.type(x)", "python.vars()", "type(x)", "vars()",
    "globals()", "getattr(x, 'real')", "word.format_map(limits)", "template.format(x)", "items.format([1])",
    "wide.format(1)", "word.encode()", "word.translate({})", "(y := 1)", "[y := 1]", "f'{x}'", "{1, 2}",
    "{i for i in 'ab'}", "b'bytes'", "1j", "...", "max(*[1, 2])", "dict(**limits)", "{**limits}",
    "[i async for i in 'ab']", "await x", "(yield)", "[x for x.y in [1]]", "[0 for limits['lower'] in [1]]",
    "nope", "limits.nope", "'%(a(b)c)99999999d' % {'a(b)c': 1}", "'%*d' % (99999999, 1)", "1 in x", "x[0]",
    "import os", "x = 1", "x; x", "", "(" * 500, "-" * 9000 + "1", "x" + " + x" * 2000,
    "str(len)(1)", "limits.get.__self__",
    "map(lambda i: i, [1])", "sorted('ab', key=print)", "isinstance(x, object)",
    "python.isinstance(x, python.map)", "breakpoint()", "math.sys", "xacro",
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("text", ATTACKS)
def test_what_is_not_listed_is_refused(text):
    with pytest.raises(XacroError) as error:
        value(text)
    assert len(str(error.value)) < 1000


BOMBS = [
    "9**9**9", "9**999999999", "(9**900)**900", "2**4000 * 2**4000", "1 << 10**9", "'a' * 10**10",
    "[0] * 10**9", "10**9 * [0]", "('a' * 10**6) * 10", "range(10**12)", "list(range(10**7))",
    "[i for i in range(9**5) for j in range(9**5)]", "[[0] * 10**5 for i in range(10**5)]",
    "math.factorial(10**7)", "math.comb(10**6, 10**5)", "math.perm(10**5)", "round(1, -10**9)",
    "math.prod([2**4000] * 99999)", "'%999999999d' % 1", "'%.999999999f' % 1.0", "'a'.ljust(10**10)",
    "'a'.zfill(10**10)", "'a'.center(10**9)", "('a' * 10**6).replace('a', 'b' * 10**6)",
    "('b' * 10**6).join(['a'] * 10**5)", "''.join(['a' * 10**6] * 10**5)", "int('9' * 10**6)",
    "'%s' * 99999 % (('a' * 9999,) * 99999)", "'%(a)s' * 99999 % dict(a='b' * 99999)",
    "{i * (2**61 - 1): 0 for i in range(50000)}",
    pytest.param("dict([[i * (2**61 - 1), 0] for i in range(9**5)])", marks=pytest.mark.long),
    "python.sum([[]] * 99999, [])", "[str([0] * 99999) for i in range(99999)]",
    "('a' * 10**6).split('a')", "[('a' * 10**6).upper() for i in range(10**5)]",
    "[x for x in range(99999) if python.any([y == x for y in range(99999)])]",
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("text", BOMBS)
def test_time_and_memory_are_bounded(text, within):
    began = time.process_time()
    with within(20), pytest.raises(XacroError):
        value(text)
    assert time.process_time() - began < 6


def test_values_that_contain_each_other_twice_do_not_grow_without_limit(within):
    names = {"a0": [0, 1]}
    with within(10), pytest.raises(XacroError, match="items"):
        for n in range(60):
            names[f"a{n + 1}"] = evaluate(f"[a{n}, a{n}]", NameSpace(names), Budget())
            text_of(names[f"a{n + 1}"])


def test_a_budget_is_for_all_expressions_of_a_file():
    budget = Budget(1000)
    with pytest.raises(XacroError, match="operations"):
        for _ in range(1000):
            evaluate("1 + 1", NAMES, budget)


# --- fuzz: any text, and any tree of Python's grammar ---
WORDS = [*NAMES._names, "__class__", "__globals__", "format", "join", "split", "lower", "get", "for", "in",
         "if", "else", "lambda", "[", "]", "(", ")", "{", "}", "'", ",", ":", ".", "*", "**", "+", "%", "==",
         "1", "0.5", "9999999", " ", "'{0.__class__}'", "'%s'"]  # fmt: skip
TEXTS = st.one_of(
    st.text(string.printable, max_size=60),
    st.lists(st.sampled_from(WORDS), max_size=25).map("".join),
    st.lists(st.sampled_from(WORDS), max_size=25).map(" ".join),
)
ATOMS = st.one_of(
    st.sampled_from(["x", "word", "limits", "python", "math", "len", "map", "str", "template", "'ab'", "[]"]),
    st.integers(-(10**6), 10**6).map(repr),
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
)
OPERATORS = ["+", "-", "*", "/", "//", "%", "**", "<<", ">>", "&", "|", "^", "==", "<"]
OPERATORS += ["in", "and", "or", "is"]
NESTED = st.recursive(
    ATOMS,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(OPERATORS), inner).map(
            lambda t: f"({t[0]} {t[1]} {t[2]})"
        ),
        st.tuples(inner, st.sampled_from(["format", "join", "split", "__class__", "lower", "get", "items",
                                          "replace", "__init__", "real", "keys", "pi", "tuple"])).map(
            lambda t: f"({t[0]}).{t[1]}"
        ),
        st.tuples(inner, st.lists(inner, max_size=3)).map(lambda t: f"({t[0]})({', '.join(t[1])})"),
        st.tuples(inner, inner).map(lambda t: f"({t[0]})[{t[1]}]"),
        st.tuples(inner, inner).map(lambda t: f"[{t[0]} for x in {t[1]}]"),
        st.lists(inner, max_size=3).map(lambda t: f"[{', '.join(t)}]"),
        inner.map(lambda t: f"(lambda: {t})"),
    ),
    max_leaves=12,
)  # fmt: skip
PLAIN = (bool, int, float, str, list, tuple, dict, type(None))


@pytest.mark.long
@settings(max_examples=2000)
@given(st.one_of(TEXTS, NESTED))
@example("''.join.__globals__")
def test_any_text_gives_plain_data_or_a_clear_error(text):
    try:
        found = value(text, 20_000)
    except XacroError:
        return
    seen = [found]
    while seen:
        item = seen.pop()
        if not isinstance(item, PLAIN):  # a function or name space of ours, which has no attributes for them
            assert type(item).__module__.startswith("armcell.model.xacro")
            return
        seen += [*item.values(), *item] if isinstance(item, dict) else item if isinstance(item, list) else []
    assert size(found) <= 100_000
    # where Python's own eval gets a result from the same few names, it is the same
    safe = {n: getattr(builtins, n) for n in ("len", "map", "str")}
    if isinstance(found, int | float | str) and not any(w in text for w in ("map", "is", "python", "math")):
        try:
            ast.parse(text.strip(), mode="eval")
            real = eval(
                text.strip(), {"__builtins__": {}}, {**safe, "x": 3, "word": "left arm", "limits": LIMITS}
            )
        except Exception:
            return
        assert found == real or found != found

"""Parser from URScript text to a small syntax tree.

Grammar: Universal Robots, "The URScript Programming Language", without switch and struct. Line breaks between
statements are optional, and may follow `=` (ur_rtde's script uses both) or an operator (UR's external
control). Nodes of the tree are tuples whose first item is their kind.
"""

from __future__ import annotations

import re
from typing import Any

from armcell.core import ArmcellError

MAX_SCRIPT = 1 << 20  # characters
MAX_DIGITS, LARGEST = 400, 1e300  # of a number: characters of its text, and its value
MAX_DEPTH = 60  # nested blocks or brackets

_TOKEN = re.compile(
    r"""(?P<space>[ \t\r]+|\#[^\n]*)|(?P<newline>\n)
    |(?P<number>0[xX][0-9a-fA-F]+|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
    |(?P<text>"[^"\n]*"|'[^'\n]*')|(?P<name>[A-Za-z_]\w*)
    |(?P<sign>==|!=|<=|>=|[-+*/%<>=()\[\],:.])""",
    re.VERBOSE,
)
_WORDS = (
    "def thread sec end if elif else while return break continue global local run kill join halt "
    "enter_critical exit_critical and or not xor True False pass"
)
KEYWORDS = frozenset(_WORDS.split())

Node = tuple[Any, ...]


class ScriptError(ArmcellError):
    """Syntax error or compile error in a URScript text, found by the parser or the compiler.

    Attributes:
        line, column: position in the text, from 1; 0 refers to the whole text.
        code: text that a real controller sends on the primary interface.
    """

    def __init__(self, reason: str, line: int = 0, column: int = 0, code: str = ""):
        self.line, self.column = line, column
        self.code = code or f"syntax_error_on_line:{line}:{reason}:"
        super().__init__(f"line {line}: {reason}" if line else reason)


class _Tokens:
    def __init__(self, text: str):
        if len(text) > MAX_SCRIPT:
            raise ScriptError(f"a script of {len(text)} characters is too long (at most {MAX_SCRIPT})")
        self.items: list[tuple[str, str, int, int]] = []  # kind, text, line, column
        at, line, depth, begin = 0, 1, 0, 0
        while at < len(text):
            found = _TOKEN.match(text, at)
            if found is None:
                raise ScriptError(f"{text[at]!r} has no meaning here", line, at - begin + 1)
            column = at - begin + 1
            kind, value, at = found.lastgroup or "", found.group(), found.end()
            if kind == "newline":
                line, begin = line + 1, at
                if depth:
                    continue
            if kind == "sign":
                depth += (value in "([") - (value in ")]")
            if kind != "space":
                self.items.append((value if kind in ("sign", "newline") else kind, value, line, column))
        self.items += [("newline", "\n", line, 1), ("eof", "", line, 1)]
        self.items = [("\n" if k == "newline" else k, v, n, c) for k, v, n, c in self.items]
        self.at = 0

    @property
    def kind(self) -> str:
        kind, value, _, _ = self.items[self.at]
        return value if kind == "name" and value in KEYWORDS else kind

    def next(self) -> str:
        value = self.items[self.at][1]
        self.at += 1
        return value

    def take(self, kind: str) -> bool:
        if self.kind != kind:
            return False
        self.at += 1
        return True

    def need(self, kind: str) -> str:
        if self.kind != kind:
            self.fail(f"expected {kind!r}")
        return self.next()

    def fail(self, reason: str) -> None:
        _, value, line, column = self.items[self.at]
        shown = {"\n": "the end of the line", "": "the end of the script"}.get(value, repr(value))
        raise ScriptError(f"{reason}, not {shown}", line, column)


def parse(text: str) -> list[Node]:
    """Parse a URScript text into a syntax tree, and return the statements.

    Raises:
        ScriptError: a syntax error, with its line.
    """
    lines = (line if not line.lstrip().startswith("$") else "" for line in text.split("\n"))
    tokens = _Tokens("\n".join(lines))
    body = _block(tokens, 0, top=True)
    return body


def depth_after(line: str, depth: int) -> int:
    """Return the number of URScript blocks that are still open after the
    parser has received one more line of a streamed text.

    Args:
        line: the new line.
        depth: number of open blocks before the line.
    """
    words = re.sub(r"\"[^\"]*\"|'[^']*'|#.*", "", line).split()
    first = re.split(r"[^\w]", words[0], maxsplit=1)[0] if words else ""
    if first in ("def", "thread", "sec", "if", "while"):
        return depth + 1
    return max(depth - 1, 0) if first == "end" else depth


def _block(t: _Tokens, depth: int, top: bool = False) -> list[Node]:
    if depth > MAX_DEPTH:
        t.fail(f"blocks nested deeper than {MAX_DEPTH}")
    body: list[Node] = []
    while True:
        if t.take("\n"):
            continue
        if t.kind in ("end", "elif", "else") and not top:
            return body
        if t.kind == "eof":
            if top:
                return body
            t.fail("expected 'end'")
        line = t.items[t.at][2]
        body.append((*_statement(t, depth), line))


def _statement(t: _Tokens, depth: int) -> Node:
    kind = t.kind
    if kind in ("def", "thread", "sec"):
        return _function(t, depth)
    if kind == "if":
        return _if(t, depth)
    if kind == "while":
        t.next()
        condition = _expression(t)
        t.need(":")
        body = _block(t, depth + 1)
        _end(t)
        return ("while", condition, body)
    t_next: dict[str, str] = dict.fromkeys(
        ("break", "continue", "halt", "enter_critical", "exit_critical", "pass"), "word"
    )
    if kind in t_next:
        node: Node = (t.next(),)
    elif kind == "return":
        t.next()
        node = ("return", None if t.kind == "\n" else _expression(t))
    elif kind in ("kill", "join"):
        node = (t.next(), _expression(t))
    elif kind in ("global", "local"):
        t.next()
        name = t.need("name")
        node = ("assign", ("name", name), _assigned(t) if t.take("=") else ("const", 0), kind)
    else:
        target = _expression(t)
        if t.take("="):
            if target[0] not in ("name", "index"):
                t.fail("only a variable or its item can be given a value")
            node = ("assign", target, _assigned(t), "")
        else:
            node = ("do", target)
    return node


def _assigned(t: _Tokens) -> Node:
    while t.take("\n"):
        pass
    return _expression(t)


def _end(t: _Tokens) -> None:
    t.need("end")


def _function(t: _Tokens, depth: int) -> Node:
    kind, name = t.next(), t.need("name")
    t.need("(")
    parameters: list[tuple[str, Node | None]] = []
    while not t.take(")"):
        parameter = t.need("name")
        parameters.append((parameter, _expression(t) if t.take("=") else None))
        if t.kind != ")":
            t.need(",")
    t.need(":")
    body = _block(t, depth + 1)
    _end(t)
    return ("def", kind, name, parameters, body)


def _if(t: _Tokens, depth: int) -> Node:
    branches: list[tuple[Node | None, list[Node]]] = []
    t.next()
    branches.append((_condition(t), _block(t, depth + 1)))
    while True:
        if t.take("elif"):
            branches.append((_condition(t), _block(t, depth + 1)))
        elif t.take("else"):
            t.need(":")
            branches.append((None, _block(t, depth + 1)))
        else:
            _end(t)
            return ("if", branches)


def _condition(t: _Tokens) -> Node:
    condition = _expression(t)
    t.need(":")
    return condition


_LEVELS = (("or", "xor"), ("and",), ("==", "!=", "<", ">", "<=", ">="), ("+", "-"), ("*", "/", "%"))


def _expression(t: _Tokens, level: int = 0, nesting: int = 0) -> Node:
    if nesting > MAX_DEPTH:
        t.fail("expression nested too deeply")
    if level == 2 and t.take("not"):
        return ("not", _expression(t, 2, nesting + 1))
    if level == len(_LEVELS):
        return _unary(t, nesting)
    left = _expression(t, level + 1, nesting)
    while t.kind in _LEVELS[level]:
        sign = t.next()
        while t.take("\n"):  # an operator at the end of a line continues on the next line
            pass
        left = ("op", sign, left, _expression(t, level + 1, nesting))
    return left


def _unary(t: _Tokens, nesting: int) -> Node:
    if t.take("-"):
        return ("neg", _unary(t, nesting + 1))
    if t.take("+"):
        return _unary(t, nesting + 1)
    if t.take("not"):
        return ("not", _unary(t, nesting + 1))
    value = _atom(t, nesting + 1)
    while True:
        if t.take("["):
            items = _list(t, "]", nesting)
            for item in items:
                value = ("index", value, item)
        else:
            return value


def _list(t: _Tokens, close: str, nesting: int) -> list[Node]:
    items: list[Node] = []
    while not t.take(close):
        items.append(_expression(t, 0, nesting + 1))
        if t.kind != close:
            t.need(",")
    return items


def _atom(t: _Tokens, nesting: int) -> Node:
    kind = t.kind
    if kind == "number":
        text = t.next()
        whole = re.fullmatch(r"0[xX][0-9a-fA-F]+|\d+", text)
        if len(text) > MAX_DIGITS:
            t.fail(f"a number of {len(text)} characters")
        value = int(text, 0) if whole and not re.fullmatch(r"0\d+", text) else float(text)
        if value > LARGEST:
            t.fail(f"the number {text} is too large for a controller")
        return ("const", value)
    if kind == "text":
        return ("const", t.next()[1:-1])
    if kind in ("True", "False"):
        return ("const", t.next() == "True")
    if t.take("("):
        value = _expression(t, 0, nesting)
        t.need(")")
        return value
    if t.take("["):
        return ("list", _list(t, "]", nesting))
    if t.take("run"):
        call = _atom(t, nesting)
        if call[0] != "call":
            t.fail("expected a thread's call after 'run'")
        return ("run", call)
    if kind != "name":
        t.fail("expected a value")
    place = t.items[t.at][2:]
    name = t.next()
    if name == "p" and t.kind == "[":
        t.next()
        items = _list(t, "]", nesting)
        if len(items) not in (1, 6):
            t.fail("a pose has six numbers")
        # A variable may also be named p; then a single item is its index.
        return ("pose", items) if len(items) == 6 else ("index", ("name", "p"), items[0])
    if not t.take("("):
        return ("name", name)
    arguments: list[tuple[str | None, Node]] = []
    while not t.take(")"):
        keyword = None
        if t.kind == "name" and t.items[t.at + 1][0] == "=":
            keyword = t.next()
            t.next()
        arguments.append((keyword, _expression(t, 0, nesting)))
        if t.kind != ")":
            t.need(",")
    return ("call", name, arguments, place)

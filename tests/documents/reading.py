"""The code blocks of the reference documents in ../shared/seeds, as text that runs.

The documents lost line breaks; two of them also lost `=`, `+=`, quotes and angle brackets. Restoring them
follows rules (below), not the single block; a caller adds only what no rule can know.
"""

from __future__ import annotations

import ast
import builtins
import io
import re
import tokenize
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

SEEDS = next(
    (p / "shared/seeds" for p in Path(__file__).parents if (p / "shared/seeds").is_dir()),
    Path(__file__).parents[3] / "shared/seeds",
)
UNITY, PICK_PLACE, DUAL = "000_", "001_", "002_"  # file names begin with these

HEADERS = ("class", "def", "if", "elif", "else", "for", "while", "try", "except", "finally", "with")
BEGINS = (*HEADERS, "from", "import", "return", "raise", "pass")
OPERATORS = ("and", "or", "not", "in", "is", "as", "lambda")


def available() -> bool:
    return SEEDS.is_dir()


def document(name: str) -> str:
    """The text of the document whose file name begins with `name`."""
    (file,) = SEEDS.glob(f"{name}*")
    return file.read_text(encoding="utf-8")


def block(name: str, begin: str, end: str) -> str:
    """The text from `begin` (included) up to `end` (excluded); `begin` occurs once."""
    text = document(name)
    assert text.count(begin) == 1, f"{begin!r} occurs {text.count(begin)} times in {name}"
    start = text.index(begin)
    return text[start : text.index(end, start + len(begin))]


# --- comments ---
def without_comments(text: str) -> str:
    """Replace comments by line breaks: a comment ends with the word of its last character beyond ASCII."""
    parts = text.split("#")
    kept = [parts[0]]
    for part in parts[1:]:
        foreign = [i for i, c in enumerate(part) if ord(c) > 127]
        end = foreign[-1] if foreign else 0
        while end < len(part) and (not part[end].isspace() or part[end - 1] == ","):
            end += 1
        kept.append("\n" + part[end:])
    return "".join(kept)


# --- Python ---
@dataclass
class _Layout:
    """Lines with their indentation, from statements in their order."""

    lines: list[str] = field(default_factory=list)
    stack: list[str] = field(default_factory=list)  # headers whose body goes on
    ended: list[str] = field(default_factory=list)  # the stack before the last return

    def add(self, statement: str) -> None:
        word = re.match(r"\w*", statement).group()  # type: ignore[union-attr]
        if word == "class":
            self.stack = []
        elif word == "def":
            self.stack = self.stack[:1] if "(self" in statement and self.stack[:1] == ["class"] else []
        elif word in ("else", "elif", "except", "finally"):
            opener = ("try", "except") if word in ("except", "finally") else ("if", "elif", "for")
            stack = self.ended or self.stack
            while stack and stack[-1] not in opener:
                stack = stack[:-1]
            self.stack = stack[:-1]
        elif word == "return":
            while self.stack and self.stack[-1] == "for":  # a loop that returned at once would be none
                self.stack.pop()
        self.ended = []
        self.lines.append("    " * len(self.stack) + statement)
        if word in HEADERS:
            self.stack.append(word)
        elif word == "return":
            self.ended = list(self.stack)
            self.stack = self.stack[:-1]


def python(text: str, lost: bool = False, add: Iterable[str] = (), known: Iterable[str] = ()) -> str:
    """Source of a Python block.

    Args:
        text: the block as the document has it.
        lost: it also lost `=` and quotes.
        add: targets whose lost operator was `+=`.
        known: names that the block takes from elsewhere, so that they are no lost texts.
    """
    text = without_comments(text)
    if lost:
        text = re.sub(r"(rospy\.log\w+)\((?![\"'])([^()]*)\)", r'\1("\2")', text)
        text = re.sub(r"(?<=[(,\s])(/[a-z]\w*)(?=[,)\s])", r'"\1"', text)
        text = re.sub(r"\b(queue_size|size|wait)(?=[\d(TF])", r"\1=", text)
    layout = _Layout()
    for line in text.split("\n"):
        for statement in _statements(line, lost, tuple(add)):
            layout.add(statement)
    source = "\n".join(layout.lines) + "\n"
    return _with_quotes(source, {*known}) if lost else source


def _ends_operand(token: str) -> bool:
    return (token[-1].isalnum() or token[-1] in "_)]}\"'") and token not in (*BEGINS, *OPERATORS)


def _begins_operand(token: str) -> bool:
    return (token[0].isalnum() or token[0] in "_\"'") and token not in OPERATORS


def _statements(line: str, lost: bool, add: tuple[str, ...]) -> list[str]:
    """Split one line into statements."""
    found: list[str] = []
    now, last, depth, end = "", "", 0, 0

    def close() -> None:
        nonlocal now, last
        if now.strip():
            found.append(now.strip())
        now, last = "", ""

    for kind, token, (_, at), (_, after), _ in tokenize.generate_tokens(io.StringIO(line.strip()).readline):
        if kind in (tokenize.NEWLINE, tokenize.NL, tokenize.ENDMARKER, tokenize.INDENT, tokenize.DEDENT):
            continue
        spaced = at > end
        completes = token == "import" and now.startswith("from") and " import" not in now
        if last and depth == 0 and not completes:
            opens = token[0] in "([" and spaced
            begins = token in BEGINS
            if (
                lost
                and token == "-"
                and spaced
                and line.strip()[after : after + 1] != " "
                and _is_target(now)
            ):
                now += " ="
            elif _ends_operand(last) and (begins or opens or _begins_operand(token)):
                if lost and not begins and _is_target(now):
                    now += " +=" if now.strip() in add else " ="
                else:
                    close()
            elif begins and last == ")":
                close()
        elif lost and depth and spaced and _ends_operand(last) and _begins_operand(token):
            now += " +"
        now += (" " if spaced and now else "") + token
        last, end = token, after
        depth += (token in "([{") - (token in ")]}")
        if token == ":" and depth == 0 and now.split()[0].rstrip(":") in HEADERS:
            close()
    close()
    return found


def _is_target(text: str) -> bool:
    return re.fullmatch(r"\s*[A-Za-z_][\w.]*(\[\w+\])?", text) is not None and text.strip() not in BEGINS


def _with_quotes(source: str, known: set[str]) -> str:
    """Make texts of names that nothing defines and that are neither called nor asked for a part."""
    tree = ast.parse(source)
    bound = set(dir(builtins)) | known
    used = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            bound.add(node.id)
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            bound.add(node.name)
        elif isinstance(node, ast.arg):
            bound.add(node.arg)
        elif isinstance(node, ast.alias):
            bound.add((node.asname or node.name).split(".")[0])
        elif isinstance(node, ast.Attribute):
            used.add(id(node.value))
        elif isinstance(node, ast.Call):
            used.add(id(node.func))

    class Quote(ast.NodeTransformer):
        def visit_Name(self, node: ast.Name) -> ast.expr:
            return node if node.id in bound or id(node) in used else ast.Constant(node.id)

    return ast.unparse(ast.fix_missing_locations(Quote().visit(tree))) + "\n"


# --- YAML ---
def yaml_text(text: str) -> str:
    """A YAML block: a key right behind a key is below it, every other key is beside the one before."""
    words = re.findall(r"\{[^}]*\}|\S+", without_comments(text))
    lines: list[str] = []
    levels: list[int] = []  # of each line that only opens a mapping
    level, value_due = 0, False
    index = 0
    while index < len(words):
        word = words[index]
        following = words[index + 1] if index + 1 < len(words) else ""
        if word == "-":
            lines.append("  " * level + f"- {following}")
            index += 2
            value_due = False
            continue
        assert word.endswith(":"), f"{word!r} is no key"
        if value_due:
            level += 1
            levels.append(level)
        if following == "-" or following.endswith(":"):
            lines.append("  " * level + word)
            value_due, index = following != "-", index + 1
        else:
            lines.append("  " * level + f"{word} {following}")
            value_due, index = False, index + 2
    return "\n".join(lines) + "\n"


# --- XML ---
ATTRIBUTES = ("name", "pkg", "type", "output", "value", "file", "default", "unless", "if", "filename",
              "prefix", "joint_limited", "params", "to", "from")  # fmt: skip


def xml_text(text: str, tags: Iterable[str], root: str = "") -> str:
    """An XML block without its brackets, equals signs and quotes: `node nameA pkgB/` is one element."""
    text = re.sub(r"!--.*?--", " ", text).replace(". ..", " ").replace("...", " ")
    for _ in range(4):  # blanks within $(...) and [...] separate no attributes
        text = re.sub(r"(\$\([^)\s]*|\[[^\]\s]*) ", r"\1~", text)
    found: list[str] = []
    is_open = False
    for raw in text.split():
        word, closed = raw.replace("~", " "), False
        if word.startswith("/") and word[1:] in tags:
            found.append((">" if is_open else "") + f"</{word[1:]}>")
            is_open = False
            continue
        if word.endswith("/"):
            word, closed = word[:-1], True
        if word in tags:
            found.append((">" if is_open else "") + f"<{word}")
            is_open = True
        elif word:
            name = max((a for a in ATTRIBUTES if word.startswith(a)), key=len)
            found.append(f' {name}="{word[len(name) :]}"')
        if closed:
            found.append("/>")
            is_open = False
    body = "".join(found)
    namespace = ' xmlns:xacro="http://www.ros.org/wiki/xacro"'
    return f"<{root}{namespace}>{body}</{root}>" if root else body

"""Xacro processor: expands a xacro file into URDF text without running code from the file.

armcell has its own processor because the library `xacro` cannot be made safe from outside. The library calls
Python's `eval` in three places (expressions, `$(eval)`, units in YAML) behind a filter that a lambda
bypasses; it keeps state in module variables, reads any file, parses entities and expands without limit.
Replacing these functions at run time would replace most of the library, and after a renaming in the library
`eval` would silently be active again. Tests compare the results of both processors on the same files, element
by element.

The processor reads the source tree and writes a new tree. As in plain xacro, it expands each text once, a
macro sees the properties of its caller, and a property is evaluated at its first use.
"""

from __future__ import annotations

import keyword
import logging
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lxml import etree

from armcell.core import InputError
from armcell.model.command_line_options import xacro_args
from armcell.model.untrusted_files import parse_xml, read_text
from armcell.model.xacro.budget import CHARACTERS, Budget, Function, XacroError
from armcell.model.xacro.elements import (
    Element,
    append_text,
    is_xacro,
    is_xacro_tag,
    label,
    move_content,
    name_spaces,
    required,
    set_attribute,
)
from armcell.model.xacro.expressions import AttributeDict, NameSpace, evaluate
from armcell.model.xacro.files import MissingFile, RobotFiles
from armcell.model.xacro.functions import BASIC, MATH, PYTHON, plain, text_of, tokenize
from armcell.model.xacro.scope import (
    ARGUMENT,
    Macro,
    MissingArgument,
    Scope,
    Substitution,
    evaluate_text,
    find_macro,
    missing_hint,
    parameters_of,
    parent_of,
    truth,
)

log = logging.getLogger(__name__)

MAX_INCLUDES = 30  # depth of nested includes
MAX_MACROS = 200  # depth of nested macro calls
MAX_CALLS = 5000  # depth of nested Python calls, which use no C stack since Python 3.11
MAX_REASON = 600  # characters in an error message
ELEMENT_STEPS = 5
MACRO_STEPS = 25
ALLOW_ENV = "ARMCELL_ALLOW_ENV"
"""Environment variable that passes `armcell --allow-env` on to child processes."""


Place = tuple[Path, int]
"""Xacro file and line from which an element of the resulting URDF comes."""


def expand_xacro(
    file: Path,
    arguments: Mapping[str, str] | None = None,
    allow_env: bool | None = None,
    home: Path | None = None,
) -> str:
    """Expand a xacro file and return the resulting URDF text. See `expand_with_source_locations`."""
    return expand_with_source_locations(file, arguments, allow_env, home)[0]


def expand_with_source_locations(
    file: Path,
    arguments: Mapping[str, str] | None = None,
    allow_env: bool | None = None,
    home: Path | None = None,
) -> tuple[str, list[Place]]:
    """Expand a xacro file. Return the resulting URDF text and, for each of its elements in document order,
    the element's place in the xacro source.

    Args:
        file: the xacro file.
        arguments: values for `$(arg NAME)`, like `name:=value` on xacro's command line. `--xacro-arg` on
            armcell's own command line replaces them.
        allow_env: whether the file may read environment variables with `$(env)` and `$(optenv)`. None: only
            if ARMCELL_ALLOW_ENV is set.
        home: folder that contains all files of the robot; by default the file's package or folder.
    Raises:
        InputError: the expansion failed; the message contains file, line and reason.
    """
    if allow_env is None:
        allow_env = os.environ.get(ALLOW_ENV, "") not in ("", "0")
    root = parse_xml(read_text(file), file)
    given = xacro_args(arguments)
    work = _Expansion(file, dict(given), allow_env, home)
    try:
        with _deep_calls():
            text, places = work.document(root)
    except MissingArgument as error:
        raise work.failed(error.reason, missing_hint(_missing(root, error.name, given))) from None
    except MissingFile as error:
        given_or_default = work.substitution.values.items()
        values = ", ".join(f"{k}={v!r}" for k, v in given_or_default if error.depends_on(v))
        cause = f"; the path may depend on arguments: {values} (--xacro-arg NAME:=VALUE)" if values else ""
        raise work.failed(error.reason, f"{error.hint}{cause}") from None
    except XacroError as error:
        raise work.failed(error.reason, error.hint) from None
    except RecursionError:
        raise work.failed("it is nested too deeply") from None
    if unknown := sorted(set(given) - work.substitution.declared):
        known = ", ".join(sorted(work.substitution.declared)) or "none"
        log.warning("%s: has no xacro argument %s; it has %s", file, ", ".join(unknown), known)
    return text, places


def _missing(root: Element, name: str, given: Mapping[str, str]) -> list[str]:
    """List the arguments that must still be given to expand a xacro file: `name`, and every argument that the
    file uses but that is neither declared in the file nor in `given`.
    """
    text = etree.tostring(root, encoding="unicode")
    known = {*given, *(str(e.get("name")) for e in root.iter() if is_xacro_tag(e, "arg"))}
    return list(dict.fromkeys([name, *(n for n in ARGUMENT.findall(text) if n not in known)]))


class _Expansion:
    """State of the expansion of one xacro file. Macros and properties are in `Scope` objects."""

    def __init__(self, file: Path, arguments: dict[str, str], allow_env: bool, home: Path | None):
        self.file = file
        self.budget = Budget()
        self.files = RobotFiles(file, self.budget, home)
        self.substitution = Substitution(self.files, self.budget, arguments, allow_env)
        self.reading = [self.files.main]  # stack of open files: the main file and its nested includes
        self.macros: list[str] = []  # stack of the macros that are being expanded
        self.here: Element | None = None
        self.places: dict[Element, Place] = {}  # of the elements made; holds them, so they stay the same

    def document(self, root: Element) -> tuple[str, list[Place]]:
        names = Scope(self.budget, self._substitute)
        names.values.update(self._names(names))
        out = etree.Element(root.tag, nsmap=name_spaces(root))
        self.places[out] = self._place(root)
        scope, macros = names.inner(), Scope(self.budget, self._substitute).inner()
        self.here = root
        try:
            self._attributes(root, out, scope)
            self._children(root, out, macros, scope)
        except MissingArgument:  # name="arm$(arg dof)" before <xacro:arg name="dof" default="7"/>
            if len(out):
                raise
            self._children(root, out, macros, scope)
            self.here = root
            self._attributes(root, out, scope)
        return etree.tostring(out, encoding="unicode"), [self.places[e] for e in out.iter(etree.Element)]

    def _place(self, source: Element) -> Place:
        url = source.getroottree().docinfo.URL
        file = Path(url) if url and Path(url) != self.files.main else self.file
        return file, source.sourceline or 1

    def failed(self, reason: str, hint: str | None = None) -> InputError:
        """Return an `InputError` that names the xacro file, line and element where the expansion failed."""
        file, line, element = self.file, None, None
        if self.here is not None:
            (file, line), element = self._place(self.here), label(self.here)
        if file != self.file:
            reason = f"{reason} (part of {self.file})"
        reason = f"xacro cannot expand it: {_one_line(reason)}"
        return InputError(reason, file=file, line=line, element=element, hint=hint and _one_line(hint))

    def _substitute(self, inside: str, scope: Scope) -> str:
        return self.substitution.resolve(inside, self.reading[-1].parent)

    def _names(self, names: Scope) -> dict[str, Any]:
        """Return the functions, constants and namespaces that all expressions can use while a xacro file is
        expanded.
        """

        def say(level: int) -> Any:
            def run(budget: Budget, /, *arguments: Any, **_: Any) -> str:
                log.log(level, "%s: %s", self.file, _one_line(" ".join(text_of(a) for a in arguments)))
                return ""

            return run

        def fatal(*arguments: Any) -> None:
            raise XacroError(" ".join(text_of(argument) for argument in arguments))

        def number(text: str) -> Any:
            return evaluate(text, names, self.budget)

        functions = {
            "load_yaml": plain("load_yaml", lambda name: self.files.yaml(self._path(name), number)),
            "abs_filename": plain("abs_filename", lambda name: str(self._path(name))),
            "dotify": plain("dotify", AttributeDict),
        }
        own = {
            **functions,
            "arg": plain("arg", self.substitution.arg),
            "fatal": plain("fatal", fatal),
            "tokenize": plain("tokenize", tokenize),
            "print_location": plain("print_location", lambda: ""),
            "message": Function("message", say(logging.INFO)),
            "warning": Function("warning", say(logging.WARNING)),
            "error": Function("error", say(logging.ERROR)),
        }
        spaces = {"math": NameSpace(MATH), "python": NameSpace(PYTHON), "xacro": NameSpace(own)}
        return {**MATH, **BASIC, **functions, **spaces}

    def _path(self, name: str) -> Path:
        """Resolve a path while a xacro file is expanded, relative to the folder of that file."""
        if "\0" in name:
            raise XacroError(f"{name!r} is not a path")
        return self.reading[-1].parent / name

    # --- elements ---
    def _attributes(self, source: Element, out: Element, scope: Scope) -> None:
        for name, value in source.attrib.items():
            if not is_xacro(source, str(name)):
                set_attribute(out, str(name), self._text(value, scope))

    def _text(self, value: Any, scope: Scope) -> str:
        return text_of(evaluate_text(str(value), scope))

    def _children(self, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        """Expand the macros and properties in a xacro element's content,
        and append the result to a URDF element.
        """
        self._words(source.text, out, scope)
        for child in source:
            self._child(child, out, macros, scope)
            self._words(child.tail, out, scope)

    def _words(self, text: str | None, out: Element, scope: Scope) -> None:
        """Expand the xacro expressions in a text and append the text to a URDF element.
        Skip pure white space.
        """
        if text and not text.isspace():
            before = out[-1].tail if len(out) else out.text
            self.budget.charge(len(before or "") // CHARACTERS)  # appending copies the existing text
            append_text(out, self._text(text, scope))

    def _child(self, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        if not isinstance(source.tag, str):
            return  # a processing instruction
        self.budget.charge(ELEMENT_STEPS)
        self.here = source
        if source.prefix == "xacro":
            self._directive(etree.QName(source).localname, source, out, macros, scope)
        else:
            self._copy(source.tag, source, out, macros, scope)

    def _directive(self, name: str, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        directive = _DIRECTIVES.get(name)
        if directive is not None:
            directive(self, source, out, macros, scope)
        else:
            self._call(name, source, out, macros, scope)

    def _copy(self, tag: str, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        """Expand the attributes and the content of a xacro element,
        and append a copy of the element to a URDF element.
        """
        try:
            made = etree.SubElement(out, tag, nsmap=name_spaces(source))
        except ValueError:
            raise XacroError(f"{tag!r} is not a valid name of an element") from None
        self.places[made] = self._place(source)
        self._attributes(source, made, scope)
        self._children(source, made, macros, scope)

    def _inside(self, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        """Expand the content (children and text) of a xacro element and append it to a URDF element. The URDF
        element gets no new attributes.

        As in plain xacro, an <xacro:attribute> directly inside `source` has no effect on `out`.
        """
        made = etree.Element("made")
        self._children(source, made, macros, scope)
        move_content(made, out)

    # --- directives ---
    def _property(self, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        name = self._text(required(source, "name"), scope)
        if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("__"):
            raise XacroError(f"{name!r} is not a valid name of a property")
        value: Any = source.get("value")
        default, where = source.get("default"), source.get("scope")
        remove = truth(evaluate_text(source.get("remove", "false"), scope))
        if (value is not None) + (default is not None) + remove > 1:
            raise XacroError(f"property {name}: 'value', 'default' and 'remove' exclude each other")
        if remove and name in scope:
            scope.remove(name)
            return
        if default is not None:
            if name in scope:
                return
            value = default
        if value is None:
            name, value = f"**{name}", source
        target, lazy = scope, truth(evaluate_text(source.get("lazy_eval", "true"), scope))
        if where == "global":
            target, lazy = scope.outermost, False
        elif where == "parent":
            target, lazy = parent_of(scope), False
        if not lazy and isinstance(value, str):
            value = evaluate_text(value, scope)
        target.put(name, value, lazy)

    def _argument(self, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        name, default = required(source, "name"), source.get("default")
        if default is None:
            raise XacroError(
                f"argument {name!r} has no default", 'add default="..."; --xacro-arg NAME:=VALUE overrides it'
            )
        if name not in self.substitution.values:
            self.substitution.values[name] = self._text(str(default), scope)

    def _if(self, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        if self._holds(source, scope):
            self._inside(source, out, macros, scope)

    def _unless(self, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        if not self._holds(source, scope):
            self._inside(source, out, macros, scope)

    def _holds(self, source: Element, scope: Scope) -> bool:
        text = required(source, "value")
        return truth(evaluate_text(text, scope), text)

    def _attribute(self, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        name, value = (self._text(required(source, key), scope) for key in ("name", "value"))
        set_attribute(out, name, value)

    def _element(self, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        key = next((k for k in source.attrib if is_xacro(source, str(k)) and str(k).endswith("}name")), None)
        if key is None:
            raise XacroError("attribute 'xacro:name' is missing")
        name = self._text(source.get(key), scope)
        if name.startswith("xacro:"):
            self._directive(name.removeprefix("xacro:"), source, out, macros, scope)
        else:
            self._copy(name, source, out, macros, scope)

    def _include(self, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        path = self._path(self._text(required(source, "filename"), scope))
        if source.get("ns") is not None:
            space = self._text(source.get("ns"), scope)
            macros.values[space] = macros = macros.inner(name_space=True)
            scope.values[space] = scope = scope.inner(name_space=True)
        found = self.files.matching(path) if set(str(path)) & set("*?[") else [path]
        optional = truth(source.get("optional") or "false")
        for each in found:
            real = self.files.checked(each)
            if optional and not os.path.isfile(real):
                continue
            if len(self.reading) > MAX_INCLUDES:
                chain = " includes ".join(one.name for one in self.reading[-3:])
                raise XacroError(f"more than {MAX_INCLUDES} files include each other: {chain}")
            root = self.files.xml(real)
            with _pushed(self.reading, each):
                self._inside(root, out, macros, scope)

    def _define(self, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        name = required(source, "name").removeprefix("xacro:")
        if name == "call" or "." in name:
            raise XacroError(f"{name!r} is not a valid name of a macro")
        macros.values[name] = Macro(source, parameters_of(source.get("params", "")))

    def _insert(self, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        name = required(source, "name")
        if f"**{name}" in scope:
            self._inside(scope.lookup(f"**{name}"), out, macros, scope)
        elif f"*{name}" in scope:
            block = scope.lookup(f"*{name}")
            self._copy(block.tag, block, out, macros, scope)
        else:
            raise XacroError(f"undefined block {name!r}")

    # --- macros ---
    def _call_named(self, source: Element, out: Element, macros: Scope, scope: Scope) -> None:
        self._call(self._text(required(source, "macro"), scope), source, out, macros, scope, skip="macro")

    def _call(
        self, name: str, source: Element, out: Element, macros: Scope, scope: Scope, skip: str = ""
    ) -> None:
        macros_there, scope_there, macro = find_macro(name, macros, scope)
        if len(self.macros) >= MAX_MACROS:
            chain = " calls ".join(self.macros[-3:])
            raise XacroError(f"more than {MAX_MACROS} macros call each other: {chain}")
        self.budget.charge(MACRO_STEPS)
        inner = scope_there.inner()
        missing = {parameter.name: parameter for parameter in macro.parameters}
        for key, value in source.attrib.items():
            if str(key) == skip or is_xacro(source, str(key)):
                continue
            if missing.pop(str(key), None) is None:
                raise XacroError(f"invalid parameter {str(key)!r} of macro {name!r}")
            inner.put(str(key), evaluate_text(str(value), scope))
        evaluated = etree.Element("blocks")
        self._children(source, evaluated, macros, scope)
        blocks = [block for block in evaluated if isinstance(block.tag, str)]
        for parameter in [p for p in missing.values() if p.is_block]:
            if not blocks:
                raise XacroError(f"macro {name!r} needs a block for {parameter.name!r}")
            inner.put(missing.pop(parameter.name).name, blocks.pop(0))
        if blocks:
            raise XacroError(f"macro {name!r} does not use the block <{blocks[0].tag}>")
        self.here = source
        for parameter in list(missing.values()):
            if parameter.forwarded and parameter.name in scope:
                inner.put(parameter.name, scope.lookup(parameter.name))
            elif parameter.default is not None:
                inner.put(parameter.name, evaluate_text(parameter.default, scope))
            else:
                continue
            del missing[parameter.name]
        if missing:
            words = " ".join(f'{parameter}="..."' for parameter in missing)
            raise XacroError(f"macro {name!r} needs the parameters {', '.join(missing)}", f"add {words}")
        with _pushed(self.macros, name):
            self._inside(macro.body, out, macros_there.inner(), inner)


_DIRECTIVES = {
    "arg": _Expansion._argument, "attribute": _Expansion._attribute, "call": _Expansion._call_named,
    "element": _Expansion._element, "if": _Expansion._if, "include": _Expansion._include,
    "insert_block": _Expansion._insert, "macro": _Expansion._define, "property": _Expansion._property,
    "unless": _Expansion._unless,
}  # fmt: skip


@contextmanager
def _deep_calls() -> Iterator[None]:
    """Raise Python's recursion limit for the expansion of recursive xacro macros.

    Each level of a recursive macro takes about ten Python frames.
    """
    before = sys.getrecursionlimit()
    sys.setrecursionlimit(max(before, MAX_CALLS))
    try:
        yield
    finally:
        sys.setrecursionlimit(before)


@contextmanager
def _pushed(stack: list[Any], item: Any) -> Iterator[None]:
    stack.append(item)
    yield
    stack.pop()  # not needed after an error, which ends the expansion


def _one_line(text: str) -> str:
    """Shorten a text to one printable line of at most 600 characters, for messages about errors in the
    expansion of a xacro file.
    """
    line = "".join(c if c.isprintable() else " " for c in " ".join(text.split()))
    return line if len(line) <= MAX_REASON else line[: MAX_REASON - 3] + "..."

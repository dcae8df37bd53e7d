"""XML elements of xacro files and of the URDF that they expand to."""

from __future__ import annotations

from typing import Any

from lxml import etree

from armcell.model.xacro.budget import XacroError

Element = etree._Element


def is_xacro_tag(element: Element, tag: str) -> bool:
    return isinstance(element.tag, str) and etree.QName(element).localname == tag and "xacro" in element.tag


def required(source: Element, name: str) -> str:
    found = source.get(name)
    if found is None:
        raise XacroError(f"attribute {name!r} is missing")
    return str(found)


def is_xacro(element: Element, attribute: str) -> bool:
    return attribute.startswith("{") and attribute.startswith(f"{{{element.nsmap.get('xacro')}}}")


def name_spaces(source: Element) -> Any:
    """Return the XML namespaces of an element in a xacro file, without the namespace of xacro itself."""
    return {prefix: uri for prefix, uri in source.nsmap.items() if prefix != "xacro"}


def set_attribute(out: Element, name: str, value: str) -> None:
    try:
        out.set(name, value)
    except ValueError as error:
        raise XacroError(f"attribute {name!r}: {error}") from None


def append_text(out: Element, text: str) -> None:
    try:
        if len(out):
            out[-1].tail = (out[-1].tail or "") + text
        else:
            out.text = (out.text or "") + text
    except ValueError as error:
        raise XacroError(f"text in <{out.tag}>: {error}") from None


def move_content(made: Element, out: Element) -> None:
    """Move the text and the child elements of one XML element of a xacro file to the end of another
    element.
    """
    if made.text:
        append_text(out, made.text)
    out.extend(list(made))


def label(element: Element) -> str:
    name = element.get("name")
    prefix = f"{element.prefix}:" if element.prefix else ""
    return f"<{prefix}{etree.QName(element).localname}{f' name={name!r}' if name else ''}>"

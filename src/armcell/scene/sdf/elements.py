"""Access to values in SDF's XML elements; errors name the file, line and element."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lxml import etree

from armcell.core import SE3, SO3, InputError

Element = etree._Element


@dataclass(frozen=True)
class SkippedElement:
    """An SDF element that armcell has not converted, or has converted only approximately."""

    file: Path
    line: int
    what: str  # the element, e.g. "<sensor name='camera'>"
    why: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.what}: {self.why}"


def file_of(element: Element) -> Path:
    return Path(element.getroottree().docinfo.URL or "")


def label(element: Element) -> str:
    name = element.get("name")
    return f"<{element.tag}{f' name={name!r}' if name else ''}>"


def fail(element: Element, reason: str, hint: str | None = None) -> InputError:
    return InputError(
        reason, file=file_of(element), line=element.sourceline, element=label(element), hint=hint
    )


def skipped(element: Element, why: str) -> SkippedElement:
    return SkippedElement(file_of(element), element.sourceline or 0, label(element), why)


def children(element: Element, tag: str) -> list[Element]:
    """Return the children of an SDF element that have a given tag."""
    return [child for child in element if child.tag == tag]


def child(element: Element, path: str) -> Element | None:
    """Return the first descendant of an SDF element at a path of tags such as "surface/friction", or None."""
    at: Element | None = element
    for tag in path.split("/"):
        at = next(iter(children(at, tag)), None) if at is not None else None
    return at


def local_child(element: Element, name: str) -> Element | None:
    """Return the first child of an SDF element that has a given local name, in any namespace, or None.

    For example, "mu_static" matches <drake:mu_static>.
    """
    return next((c for c in element if isinstance(c.tag, str) and c.tag.rpartition("}")[2] == name), None)


def name_of(element: Element) -> str:
    """Return the attribute `name` of an SDF element.

    Raises:
        InputError: the attribute is missing or empty.
    """
    name = (element.get("name") or "").strip()
    if not name:
        raise fail(element, "attribute 'name' is missing")
    return name


def text_of(element: Element, path: str, default: str | None = None) -> str:
    """Return the text in the descendant of an SDF element at a path of tags such as "surface/friction".

    Raises:
        InputError: the element is missing or empty, and there is no default.
    """
    found = child(element, path)
    if found is None or not (found.text or "").strip():
        if default is not None:
            return default
        raise fail(element, f"has no <{path}>" if found is None else f"<{path}> is empty")
    return (found.text or "").strip()


def numbers(element: Element, text: str, count: int) -> list[float]:
    """Parse the text of an SDF element as a given number of finite numbers.

    Args:
        element: the element that contains the text, for error messages.
        text: numbers separated by white space.
        count: the required number of values.
    Raises:
        InputError: a different number of values, or a value is not a finite number.
    """
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        raise fail(element, f"{text[:80]!r} is not a list of numbers") from None
    if len(values) != count or not np.all(np.isfinite(values)):
        raise fail(element, f"{text[:80]!r} must be {count} finite number{'s' if count > 1 else ''}")
    return values


def vector(element: Element, path: str, count: int, default: str | None = None) -> list[float]:
    found = child(element, path)
    return numbers(element if found is None else found, text_of(element, path, default), count)


def number(element: Element, path: str, default: float | None = None) -> float:
    return vector(element, path, 1, None if default is None else repr(default))[0]


def flag(element: Element, path: str, default: bool = False) -> bool:
    """Return the Boolean value (true, false, 1 or 0) of the descendant that `path`, a path of tags, selects
    in an SDF element.

    Raises:
        InputError: the text is not a boolean.
    """
    text = text_of(element, path, "true" if default else "false").lower()
    if text not in ("true", "false", "1", "0"):
        raise fail(element, f"<{path}> is {text!r}", "write true or false")
    return text in ("true", "1")


def pose_of(element: Element | None) -> SE3:
    """Return the pose in the <pose> child of an SDF element, or the identity if it is missing or empty.

    The text contains x, y, z and roll, pitch, yaw, or x, y, z and a quaternion.

    Raises:
        InputError: a value is not a number, the rotation format is unknown, or a quaternion has length 0.
    """
    if element is None or not (element.text or "").strip():
        return SE3.identity()
    text, form = element.text or "", element.get("rotation_format", "euler_rpy")
    if form == "quat_xyzw":
        values = numbers(element, text, 7)
        if np.linalg.norm(values[3:]) < 1e-9:
            raise fail(element, f"{text.strip()!r} has a quaternion of length 0")
        return SE3.from_quat_xyzw(values[:3], np.asarray(values[3:]) / np.linalg.norm(values[3:]))
    if form != "euler_rpy":
        raise fail(element, f"rotation_format {form!r} is unknown", "use euler_rpy or quat_xyzw")
    values = numbers(element, text, 6)
    degrees = element.get("degrees", "false").lower() in ("true", "1")
    return SE3(SO3.from_rpy(np.deg2rad(values[3:]) if degrees else values[3:]), np.asarray(values[:3]))

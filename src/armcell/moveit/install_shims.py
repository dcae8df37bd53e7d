"""Installation of the ROS shims under the module names that scripts import."""

from __future__ import annotations

import importlib
import importlib.util
import sys
import types
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from armcell.core import UnknownNameError
from armcell.moveit.message_classes import MessageClasses
from armcell.moveit.script_hints import MESSAGES
from armcell.moveit.session import current_session

SHIMS = {
    "rospy": "rospy",
    "actionlib": "actionlib",
    "genpy": "genpy",
    "tf": "tf",
    "tf.transformations": "transformations",
    "tf2_ros": "tf2_ros",
    "tf2_geometry_msgs": "tf2_geometry_msgs",
    "moveit_commander": "moveit_commander",
    "moveit_commander.conversions": "moveit_commander.conversions",
    "moveit_commander.exception": "moveit_commander.exception",
    "moveit_commander.move_group": "moveit_commander.move_group",
    "moveit_commander.planning_scene_interface": "moveit_commander.planning_scene_interface",
    "moveit_commander.robot": "moveit_commander.robot",
    "moveit_commander.roscpp_initializer": "moveit_commander.roscpp_initializer",
}
"""Module name that a script imports -> module in `armcell.moveit.shims`."""


class _MessageModule(types.ModuleType):
    """Shim module that is installed as `<package>.msg` or `<package>.srv` of a ROS message package. It
    creates each message class on first access.
    """

    def __init__(self, name: str, classes: MessageClasses, package: str, kinds: list[str]):
        super().__init__(name)
        self._classes, self._package, self._kinds = classes, package, kinds
        self.__all__ = kinds

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        full = f"{self._package}/{name}"
        if full in MESSAGES:
            meant = MESSAGES[full]
            current_session().hint(
                full,
                f"MoveIt has no {full}; armcell takes it as {meant}: import {meant.split('/')[1]} instead",
            )
            return self._classes[meant]
        if self.__name__.endswith(".msg") and full in self._classes.schema.services:
            current_session().hint(
                full, f"{name} is a service; in ROS, write: from {self._package}.srv import {name}"
            )
            return _service_class(self._classes, full)
        if name not in self._kinds:
            known = [k for k in self._kinds if not k.startswith("_")]
            raise AttributeError(str(UnknownNameError(f"type of {self.__name__}", name, known)))
        value = (
            _service_class(self._classes, f"{self._package}/{name}")
            or self._classes[f"{self._package}/{name}"]
        )
        setattr(self, name, value)
        return value

    def __dir__(self) -> list[str]:
        return self._kinds


def _service_class(classes: MessageClasses, name: str) -> type | None:
    """Return a service class for an installed shim module. It contains the request class and the response
    class of the service.

    Returns:
        The class, or None if the name is not a service.
    """
    if name not in classes.schema.services:
        return None
    request, response = classes[f"{name}Request"], classes[f"{name}Response"]
    return type(
        name.split("/")[1], (),
        {
            "_type": name, "_md5sum": classes.schema.md5(name),
            "_request_class": request, "_response_class": response, "Request": request, "Response": response,
        },
    )  # fmt: skip


def message_modules(classes: MessageClasses) -> dict[str, types.ModuleType]:
    """Create the shim modules to install for all ROS message packages, with their `.msg` and `.srv`
    submodules.
    """
    schema = classes.schema
    parts = {f"{s}{end}" for s in schema.services for end in ("Request", "Response")}
    found: dict[str, types.ModuleType] = {}
    for kind, names in (
        ("msg", [n for n in schema.messages if n not in parts]),
        ("srv", [*schema.services, *parts]),
    ):
        for package in sorted({n.split("/")[0] for n in names}):
            own = sorted(n.split("/")[1] for n in names if n.split("/")[0] == package)
            outer = found.setdefault(package, types.ModuleType(package))
            outer.__path__ = []  # type: ignore[attr-defined]  # marks the module as a package
            inner = _MessageModule(f"{package}.{kind}", classes, package, own)
            found[inner.__name__] = inner
            setattr(outer, kind, inner)
    return found


@contextmanager
def shims_installed(classes: MessageClasses) -> Iterator[list[str]]:
    """Install the ROS shims (rospy, moveit_commander, tf, ...) in
    `sys.modules` for the duration of a `with` block.

    The previous modules are restored after the block.

    Yields:
        Names of installed packages that the shims hide during the block.
    """
    modules: dict[str, types.ModuleType] = message_modules(classes)
    for name, file in SHIMS.items():
        modules[name] = importlib.import_module(f"armcell.moveit.shims.{file}")
    before = {n: sys.modules[n] for n in modules if n in sys.modules}
    hidden = sorted(n for n in modules if "." not in n and (n in before or importlib.util.find_spec(n)))
    sys.modules.update(modules)
    try:
        yield hidden
    finally:
        for name in modules:
            sys.modules.pop(name, None)
        sys.modules.update(before)

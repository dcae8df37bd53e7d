"""Registries of components by name, such as planners, IK solvers, stages and drivers.

A component registers itself with `@registry.register("name")` when its module is imported. Installed packages
are found through entry points: a package that declares

    [project.entry-points."armcell.planners"]
    my_planner = "my_package.my_planner"

has its module `my_package.my_planner` imported when a registry of the group `armcell.planners` is first asked
for a name that it does not know, or for all names. So packages cost no time until armcell needs them.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint, entry_points
from typing import Generic, TypeVar, cast

from armcell.core.errors import UnknownNameError

T = TypeVar("T")
V = TypeVar("V")

log = logging.getLogger(__name__)

_loaded: set[str] = set()  # groups whose entry points have been loaded
_loading = threading.RLock()


def load_plugins(group: str) -> None:
    """Import the plugin modules that installed packages declare for a registry. Each module is imported once
    per process.

    A plugin that fails to import gives a warning that names the plugin, its package and the error; the other
    plugins are loaded.
    """
    with _loading:
        if group in _loaded:
            return
        _loaded.add(group)  # before the import, because plugins use the registries
        for point in entry_points(group=group):
            try:
                point.load()
            except (Exception, SystemExit) as error:
                log.warning(
                    "plugin %s (entry point of group %s) of package %s cannot be loaded: %s: %s",
                    f"{point.name} = {point.value}", group, _package(point), type(error).__name__, error,
                )  # fmt: skip


def _package(point: EntryPoint) -> str:
    dist = point.dist
    return "?" if dist is None else f"{dist.name} {dist.version}"


class Registry(Generic[T]):
    """Registry that maps names to components, such as planners or drivers.

    `@registry.register("name")` adds a component; `registry["name"]` returns it.

    Args:
        kind: what the components are, for messages: "planner", "mode".
        group: group of the entry points through which installed packages add components; empty: none.
    """

    def __init__(self, kind: str, group: str = ""):
        self.kind, self.group = kind, group
        self._items: dict[str, T] = {}

    def register(self, name: str) -> Callable[[V], V]:
        def add(item: V) -> V:
            if name in self._items:
                raise ValueError(f"{self.kind} {name!r} is registered twice")
            self._items[name] = cast(T, item)
            return item

        return add

    def imported(self) -> dict[str, T]:
        """Return the components in a registry that imported modules have registered, without loading
        plugins.
        """
        return dict(self._items)

    def _load_plugins(self) -> None:
        if self.group:
            load_plugins(self.group)

    def __getitem__(self, name: str) -> T:
        if name not in self:
            raise UnknownNameError(self.kind, name, self._items)
        return self._items[name]

    def __contains__(self, name: object) -> bool:
        if name not in self._items:
            self._load_plugins()
        return name in self._items

    def __iter__(self) -> Iterator[str]:
        self._load_plugins()
        return iter(sorted(self._items))

    def __len__(self) -> int:
        self._load_plugins()
        return len(self._items)

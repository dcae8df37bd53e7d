"""The robots of armcell's library: the sources of their descriptions and their availability."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from armcell.core import InputError
from armcell.model.assets import resolve_uri
from armcell.model.untrusted_files import read_yaml

LIBRARY = Path(__file__).parent / "library"
ROBOT_FILE = "robot.yaml"


@dataclass(frozen=True)
class KnownRobot:
    """A robot in armcell's library, with the source of its description.

    Attributes:
        source: maker, model, and origin of the description with its license.
        description: web address of the maker's description, if no Python package ships it.
        package: ROS package of that description that is missing on this machine, or None.
    """

    name: str
    source: str
    description: str = ""
    package: str | None = None

    @property
    def hint(self) -> str:
        """Return a hint on how to install the ROS package that describes a robot.
        It is empty if the package is present.
        """
        if self.package is None or not self.description:
            return ""
        return f"get {self.package} from {self.description} and pass --package {self.package}=FOLDER"


def robot_names() -> list[str]:
    """Return the names of the robots in armcell's library."""
    return sorted(p.parent.name for p in LIBRARY.glob(f"*/{ROBOT_FILE}"))


def installed_robots() -> list[str]:
    """Return the names of the robots in armcell's library whose
    descriptions are installed on this machine.
    """
    return [name for name in robot_names() if known_robot(name).package is None]


def known_robot(name: str) -> KnownRobot:
    """Return a robot's entry in armcell's library, by name. The robot model is not loaded."""
    folder = LIBRARY / name
    data = read_yaml(folder / ROBOT_FILE)
    about = str(data.get("source", "")), str(data.get("description", ""))
    uri = str(data.get("urdf", data.get("mjcf", "")))
    package = uri.removeprefix("package://").split("/")[0] if uri.startswith("package://") else None
    if package is not None:
        try:
            resolve_uri(uri, folder)
            package = None
        except InputError:
            pass
    return KnownRobot(name, *about, package)

"""Setting up a cell from a URDF: what the set-up assistant proposes, and the folder it writes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from armcell.cell.setup_poses import with_poses
from armcell.collision.self_collision import LinkPair, link_pairs
from armcell.model import RobotModel
from armcell.model.setup import (
    MoveItConfig,
    UrdfPart,
    defaults,
    described,
    merged_urdf,
    package_files,
    srdf_text,
    with_groups,
    write_folder,
    yaml_text,
)
from armcell.model.setup.gripper import find_grippers
from armcell.model.urdf import parse_urdf

LIMITS_NOTE = (
    "Velocities are the URDF's. A URDF has no accelerations: those below are what MoveIt assumes where none",
    "are given. Put in the maker's figures; armcell keeps to max_jerk as well.",
)


@dataclass(frozen=True, eq=False)
class Proposal:
    """A robot as it would be set up: groups, end effectors, states and pairs are in `model`."""

    model: RobotModel
    pairs: tuple[LinkPair, ...]
    urdf_text: str
    package: MoveItConfig | None = None  # that it was read from; its files are written as they are

    @property
    def loose_joints(self) -> tuple[str, ...]:
        """Driven joints that belong to no group."""
        driven = {n for g in self.model.groups.values() for n in g.joint_names}
        return tuple(n for n in self.model.joint_names if n not in driven)

    def without(self, pair: frozenset[str]) -> Proposal:
        """The same with a pair of links to be checked after all."""
        disabled = {p: why for p, why in self.model.disabled_collisions.items() if p != pair}
        return replace(self, model=replace(self.model, disabled_collisions=disabled))

    def disabling(self, pair: frozenset[str]) -> Proposal:
        """The same with the contact of a pair of links ignored, on the user's word."""
        found = next(p for p in self.pairs if p.links == pair)
        disabled = {**self.model.disabled_collisions, pair: found.reason or "User"}
        return replace(self, model=replace(self.model, disabled_collisions=disabled))


def propose(
    parts: Sequence[UrdfPart],
    samples: int = 100_000,
    seed: int = 0,
    name: str | None = None,
    progress: Callable[[str, int], None] | None = None,
) -> Proposal:
    """Set up one robot, or several as one.

    Args:
        parts: URDF or xacro files with prefixes and places.
        samples: states that decide which pairs of links are checked.
        progress: told what is being done, and how many samples are.
    Raises:
        InputError: a file that is wrong, names that clash, a robot that does not move.
    """
    tell = progress or (lambda what, done: None)
    tell("reading", 0)
    name, text = merged_urdf(parts, name)
    model = parse_urdf(text, parts[0].file)
    tell("groups and poses", 0)
    model = with_poses(with_groups(model, [p.prefix for p in parts]), seed)
    tell("pairs of links", 0)
    pairs = link_pairs(model, samples, seed, lambda done: tell("pairs of links", done))
    model = replace(model, disabled_collisions={p.links: p.reason for p in pairs if p.reason})
    return Proposal(find_grippers(model), tuple(pairs), text)


def propose_from_package(folder: Path) -> Proposal:
    """A cell on an existing MoveIt package: its groups, states, pairs and limits as they are.

    Raises:
        InputError: a missing file, a name that the robot does not have, a value of the wrong type.
    """
    config = MoveItConfig.load(folder)
    return Proposal(find_grippers(config.model), (), config.urdf_text, config)


def write_cell(proposal: Proposal, folder: Path, force: bool = False) -> None:
    """Write MoveIt's package and a cell on it into a folder: all of it or nothing.

    Raises:
        InputError: the folder is there and not empty, or cannot be written.
    """
    write_folder(folder, cell_files(proposal, folder.resolve().name), force)


def cell_files(proposal: Proposal, package: str) -> dict[str, str]:
    """The files by their path in the folder."""
    model = proposal.model
    if proposal.package is not None:
        return {**proposal.package.texts(package), "cell.yaml": _cell_yaml(model)}
    urdf, srdf = f"{model.name}.urdf", f"{model.name}.srdf"
    config = {
        "joint_limits.yaml": yaml_text(defaults.joint_limits(model), *LIMITS_NOTE),
        "kinematics.yaml": yaml_text(defaults.kinematics(model)),
        "ompl_planning.yaml": yaml_text(defaults.ompl_planning(model)),
        "moveit_controllers.yaml": yaml_text(defaults.moveit_controllers(model)),
        "pilz_cartesian_limits.yaml": yaml_text(defaults.pilz_cartesian_limits()),
        urdf: proposal.urdf_text,
        srdf: srdf_text(described(model)),
    }
    return {
        **{f"config/{name}": text for name, text in config.items()},
        **package_files(package, urdf, srdf),
        "robot.yaml": _robot_yaml(model, urdf, srdf),
        "cell.yaml": _cell_yaml(model),
    }


def _robot_yaml(model: RobotModel, urdf: str, srdf: str) -> str:
    data: dict[str, Any] = {
        "name": model.name,
        "source": "armcell setup",
        "urdf": f"config/{urdf}",
        "srdf": f"config/{srdf}",
        "joint_limits": "config/joint_limits.yaml",
    }
    if model.grippers:
        data["grippers"] = {
            name: {
                "arm_group": g.arm_group,
                "group": g.group,
                "joint_name": g.joint_name,
                "tcp_link": g.tcp_link,
                "finger_links": list(g.finger_links),
                "hand_links": list(g.hand_links),
                "width_per_joint": g.width_per_joint,
                "width_offset": g.width_offset,
                "max_width": g.max_width,
                "max_force": g.max_force,
                "finger_depth": g.finger_depth,
                "pad_depth": g.pad_depth,
            }
            for name, g in model.grippers.items()
        }
    return yaml_text(data, "The robot as armcell loads it; MoveIt reads config/ alone.")


def _cell_yaml(model: RobotModel) -> str:
    start = {
        group: next(n for n in ("home", "open") if n in states)
        for group, states in model.named_states.items()
        if {"home", "open"} & set(states) and not _made_of_others(model, group)
    }
    arms = [g.arm_group for g in model.grippers.values()] or [
        g.name for g in model.groups.values() if g.tip_link
    ]
    data: dict[str, Any] = {
        "description": f"{model.name}, set up by armcell.",
        "robot": ".",
        "start": start,
        "padding": 0.005,
    }
    data["task"] = _first_task(model, arms)
    return yaml_text(
        data,
        "Add what stands around the robot under 'objects' and what it is to do under 'task':",
        "examples/05_your_own_cell shows every key; armcell check tells what is wrong.",
    )


def _first_task(model: RobotModel, arms: list[str]) -> list[dict[str, Any]]:
    """A task that runs in a cell with nothing but the robot: poses that all arms have, else a rest."""
    tables = [model.named_states.get(arm, {}) for arm in arms]
    shared = [name for name in (tables[0] if tables else {}) if all(name in table for table in tables)]
    names = [name for name in ("ready", "home") if name in shared] or shared[:2]
    return [{"move": name} for name in names] or [{"hold": 1.0}]


def _made_of_others(model: RobotModel, name: str) -> bool:
    mine = set(model.groups[name].joint_names)
    return any(g.joint_names and set(g.joint_names) < mine for g in model.groups.values())

"""Setup assistant: proposes groups, states and link pairs for a URDF, and writes a cell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from armcell.cell.gripper_proof import GripperProof, with_proven_grippers
from armcell.cell.setup_poses import with_poses
from armcell.collision.kernel.link_bodies import fit_links
from armcell.collision.self_collision import LinkPair, link_pairs
from armcell.core import InputError
from armcell.model import Gripper, Joint, RobotModel, SuctionGripper
from armcell.model.composition import with_whole_fingers
from armcell.model.loader import is_mjcf, load_mjcf_file, with_adjacent_disabled, with_keyframes
from armcell.model.mjcf import parse_mjcf, read_mjcf
from armcell.model.setup import (
    MoveItConfig,
    UrdfPart,
    defaults,
    launch_files,
    merged_urdf,
    package_files,
    srdf_of,
    srdf_text,
    with_frames_text,
    with_groups,
    write_folder,
    yaml_text,
)
from armcell.model.setup.follower import with_follower_equality, with_follower_text, with_limits_text
from armcell.model.setup.gripper_detection import GripperSpec, find_grippers
from armcell.model.urdf import load_urdf, parse_urdf
from armcell.model.urdf_writer import urdf_of

LIMITS_NOTE = (
    "Velocities are the URDF's. A URDF has no accelerations: those below are what MoveIt assumes where none",
    "are given. Put in the maker's figures; armcell keeps to max_jerk as well.",
)


@dataclass(frozen=True, eq=False)
class SetupProposal:
    """Robot setup that the setup assistant proposes: a model with groups, grippers,
    named states and disabled link pairs.

    `model` has the planning groups, end effectors, named states and the link pairs that are not checked.
    """

    model: RobotModel
    pairs: tuple[LinkPair, ...]
    urdf_text: str
    proofs: tuple[GripperProof, ...] = ()
    package: MoveItConfig | None = None  # the source package; its files are copied unchanged
    mjcf: Path | None = None  # the source if it is MJCF; armcell loads it, and MoveIt the URDF
    mjcf_text: str = ""  # the source with couplings that the user requested; armcell loads it instead

    @property
    def loose_joints(self) -> tuple[str, ...]:
        """Return the driven joints that belong to no planning group in the setup assistant's proposal."""
        driven = {n for g in self.model.groups.values() for n in g.joint_names}
        return tuple(n for n in self.model.joint_names if n not in driven)

    def without(self, pair: frozenset[str]) -> SetupProposal:
        """Return the setup proposal with collision checking enabled for a link pair."""
        disabled = {p: why for p, why in self.model.disabled_collisions.items() if p != pair}
        return replace(self, model=replace(self.model, disabled_collisions=disabled))

    def disabling(self, pair: frozenset[str]) -> SetupProposal:
        """Return the setup proposal with collision checking disabled for a link pair, at the user's
        request.
        """
        found = next(p for p in self.pairs if p.links == pair)
        disabled = {**self.model.disabled_collisions, pair: found.reason or "User"}
        return replace(self, model=replace(self.model, disabled_collisions=disabled))


def propose(
    parts: Sequence[UrdfPart],
    samples: int = 100_000,
    seed: int = 0,
    name: str | None = None,
    progress: Callable[[str, float], None] | None = None,
    grippers: Sequence[GripperSpec] = (),
) -> SetupProposal:
    """Propose a setup for one robot, or for several robots that are combined into one model.

    Args:
        parts: URDF or xacro files with prefixes and poses.
        samples: number of random states that decide which link pairs are checked for collision.
        progress: called with the current step and the finished share of the step.
        grippers: facts about the robot's grippers; setup recognizes the rest.
    Raises:
        InputError: a file is invalid, names clash, or the robot has no movable joint; a
            gripper contradicts the given facts, or does not hold a cube or plate.
    """
    tell = progress or (lambda step, done: None)
    tell("reading", 0)
    mjcf, mjcf_text = _mjcf_file(parts), ""
    if mjcf is not None:
        model, mjcf_text = _mjcf_robot(mjcf, grippers)
        model = replace(model, name=name or model.name)
        text = urdf_of(model)
    else:
        for file in {part.file: None for part in parts}:
            load_urdf(file)  # names the faults with the lines of the vendor's file, not of the merged text
        name, text = merged_urdf(parts, name)
        model = parse_urdf(text, parts[0].file, warn=False)
        for fact in grippers:
            if fact.range:
                text = with_limits_text(text, fact.drive, *fact.range)
                model = parse_urdf(text, parts[0].file, warn=False)
            if fact.follower:
                text = with_follower_text(text, model, fact.drive, fact.follower)
                model = parse_urdf(text, parts[0].file, warn=False)
    tell("groups and poses", 0)
    groups = with_groups(
        model, [p.prefix for p in parts], {fact.drive for fact in grippers},
        {link for fact in grippers for link in fact.cups},
    )  # fmt: skip
    model = find_grippers(groups, tips=True, stated=grippers)
    model = with_keyframes(with_poses(model, seed))
    text = with_frames_text(text, model)
    for done in fit_links(replace(model, disabled_collisions={})):
        tell("spheres around the links", done)
    tell("pairs of links", 0)
    pairs = link_pairs(model, samples, seed, lambda done: tell("pairs of links", done / samples))
    model = replace(model, disabled_collisions={p.links: p.reason for p in pairs if p.reason})
    tell("closing the gripper on a cube", 0)
    model, proofs = _proven(model, grippers)
    return SetupProposal(model, tuple(pairs), text, proofs, mjcf=mjcf, mjcf_text=mjcf_text)


def _mjcf_robot(file: Path, grippers: Sequence[GripperSpec]) -> tuple[RobotModel, str]:
    """Load the robot of an MJCF file. If the user couples joints, also return the MJCF text with these
    couplings, otherwise an empty text.
    """
    model, text = load_mjcf_file(file), ""
    for fact in grippers:
        if fact.range:
            raise InputError("range: armcell changes no limits of an MJCF file", file=file,
                             hint=f"set 'range' of joint {fact.drive} in the file")  # fmt: skip
        if fact.follower:
            source = read_mjcf(file)
            text = with_follower_equality(text or source.text, model, fact.drive, fact.follower)
            model = with_adjacent_disabled(parse_mjcf(replace(source, text=text)))
    return model, text


def _proven(
    model: RobotModel, grippers: Sequence[GripperSpec]
) -> tuple[RobotModel, tuple[GripperProof, ...]]:
    """Test in the setup assistant's simulation whether each gripper can hold a cube. Return the robot without
    the grippers that failed, and the test results of all grippers.

    Raises:
        InputError: a gripper about which the user stated facts does not hold the cube.
    """
    model, proofs = with_proven_grippers(with_whole_fingers(model))
    for proof in proofs:
        if grippers and not proof.held:
            raise InputError(
                f"gripper {proof.gripper.name}: {proof.text}", hint="change --gripper, or omit it"
            )
    return model, proofs


def _mjcf_file(parts: Sequence[UrdfPart]) -> Path | None:
    """Return the MJCF file if the setup consists of one robot in MJCF format.
    Return None if all robots are URDF or xacro files.

    Raises:
        InputError: an MJCF file has a prefix or pose, or is one of several parts.
    """
    found = next((part for part in parts if is_mjcf(part.file)), None)
    if found is None:
        return None
    if len(parts) > 1 or found.prefix or found.xyz is not None:
        raise InputError(
            "an MJCF robot is set up alone, without a prefix or pose", file=found.file,
            hint="set up each robot by itself and combine the folders under 'parts' in a robot.yaml",
        )  # fmt: skip
    return found.file.resolve()


def propose_from_package(folder: Path, grippers: Sequence[GripperSpec] = ()) -> SetupProposal:
    """Propose a cell for an existing MoveIt package.
    The setup assistant keeps the package's groups, states, link pairs and limits.

    Raises:
        InputError: a file is missing, a name does not exist in the robot, or a value has the wrong type.
    """
    config = MoveItConfig.load(folder)
    model, proofs = _proven(find_grippers(config.model, stated=grippers), grippers)
    return SetupProposal(model, (), config.urdf_text, proofs, config)


def write_cell(proposal: SetupProposal, folder: Path, force: bool = False) -> None:
    """Write the MoveIt package and the cell from the setup assistant into a folder.
    Either all files are written or none.

    Args:
        force: write into a folder that is not empty.
    Raises:
        InputError: the folder is not empty (without `force`), or cannot be written.
    """
    write_folder(folder, cell_files(proposal, folder.resolve().name), force)


def cell_files(proposal: SetupProposal, package: str) -> dict[str, str]:
    """Return the files of the MoveIt package and the cell that the setup assistant writes, by
    relative path.
    """
    model = proposal.model
    if proposal.package is not None:
        return {**proposal.package.texts(package), "cell.yaml": _cell_yaml(model)}
    urdf, srdf, mjcf = (f"{model.name}.{suffix}" for suffix in ("urdf", "srdf", "mjcf"))
    source = {"urdf": f"config/{urdf}"}
    if proposal.mjcf is not None:
        source = {"mjcf": f"config/{mjcf}" if proposal.mjcf_text else str(proposal.mjcf)}
    controllers = defaults.moveit_controllers(model)
    config = {
        "joint_limits.yaml": yaml_text(defaults.joint_limits(model), *LIMITS_NOTE),
        "kinematics.yaml": yaml_text(defaults.kinematics(model)),
        "ompl_planning.yaml": yaml_text(defaults.ompl_planning(model)),
        "moveit_controllers.yaml": yaml_text(controllers),
        "pilz_cartesian_limits.yaml": yaml_text(defaults.pilz_cartesian_limits()),
        urdf: proposal.urdf_text,
        srdf: srdf_text(srdf_of(model)),
    }
    names = {"urdf": urdf, "srdf": srdf, **{name.removesuffix(".yaml"): name for name in config}}
    manager = controllers["moveit_simple_controller_manager"]
    listed = {name: manager[name] for name in manager["controller_names"]}
    return {
        **{f"config/{name}": text for name, text in config.items()},
        **package_files(package, urdf, srdf),
        **launch_files(package, model.name, names, listed),
        **({f"config/{mjcf}": proposal.mjcf_text} if proposal.mjcf_text else {}),
        "robot.yaml": _robot_yaml(model, source, srdf),
        "cell.yaml": _cell_yaml(model),
    }


def _robot_yaml(model: RobotModel, source: dict[str, str], srdf: str) -> str:
    data: dict[str, Any] = {
        "name": model.name,
        "source": "armcell setup",
        **source,
        "srdf": f"config/{srdf}",
        "joint_limits": "config/joint_limits.yaml",
    }
    if "mjcf" in source and model.frames:
        data["frames"] = {name: _frame(joint) for name, joint in model.frames.items()}
    if model.grippers:
        data["grippers"] = {name: _gripper_entry(gripper) for name, gripper in model.grippers.items()}
    return yaml_text(data, "The robot as armcell loads it; MoveIt reads config/ alone.")


def _frame(joint: Joint) -> dict[str, Any]:
    T = joint.T_parent_joint
    xyz, rpy = ([round(float(v), 9) for v in values] for values in (T.translation, T.rotation.rpy))
    return {"parent_link": joint.parent, "pose": {"xyz": xyz, "rpy": rpy}}


def _gripper_entry(gripper: Gripper) -> dict[str, Any]:
    """Return the robot.yaml entry that the setup assistant writes for a gripper.
    It omits the name and all empty fields.
    """
    if isinstance(gripper, SuctionGripper):
        keys = ("arm_group", "group", "tcp_link", "hand_links", "vacuum", "evacuation", "safety")
        entry = {"kind": "suction", **{key: getattr(gripper, key) for key in keys}}
        entry["cups"] = tuple({k: list(v) if isinstance(v, tuple) else v for k, v in asdict(cup).items()}
                              for cup in gripper.cups)  # fmt: skip
    else:
        entry = {f.name: getattr(gripper, f.name) for f in fields(Gripper) if f.name != "name"}
    return {
        key: [list(v) if isinstance(v, tuple) else v for v in value] if isinstance(value, tuple) else value
        for key, value in entry.items()
        if value != ()
    }


def _cell_yaml(model: RobotModel) -> str:
    start = {
        group: next(n for n in ("home", "open") if n in states)
        for group, states in model.named_states.items()
        if {"home", "open"} & set(states) and not _made_of_others(model, group)
    }
    data: dict[str, Any] = {
        "description": f"{model.name}, set up by armcell.",
        "robot": ".",
        "start": start,
        "padding": 0.005,
    }
    data["task"] = _first_task(model)
    return yaml_text(
        data,
        "Add what stands around the robot under 'objects' and what it is to do under 'task':",
        "examples/05_your_own_cell shows every key; armcell check tells what is wrong.",
    )


def _first_task(model: RobotModel) -> list[dict[str, Any]]:
    """Return the task that the setup assistant proposes for a cell without objects: move all arms to named
    states. If the arms share no named state, the task only holds the arms still.
    """
    tables = [model.named_states.get(arm, {}) for arm in model.arm_groups]
    shared = [name for name in (tables[0] if tables else {}) if all(name in table for table in tables)]
    names = [name for name in ("ready", "home") if name in shared] or shared[:2]
    return [{"move": name} for name in names] or [{"hold": 1.0}]


def _made_of_others(model: RobotModel, name: str) -> bool:
    mine = set(model.groups[name].joint_names)
    return any(g.joint_names and set(g.joint_names) < mine for g in model.groups.values())

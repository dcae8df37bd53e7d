"""Robots for the tests of the lower rooms: URDF texts, files on this machine, pinocchio's view of them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml

from armcell.core import SE3
from armcell.model import (
    MountedRobot,
    RobotModel,
    compose,
    installed_robots,
    load_robot,
    parse_urdf,
)
from armcell.model.assets import installed_share, resolve_uri
from armcell.model.loader import LIBRARY, xacro_texts
from armcell.model.urdf import urdf_text

MBM = Path(__file__).parents[3].joinpath("shared", "data", "mbm", "robots").resolve()  # may be a link
EXAMPLES = next((s / "example-robot-data" / "robots" for s in installed_share()), Path("/nowhere"))
LIMIT = '<limit lower="-1" upper="1" velocity="2" effort="3"/>'


def link(name: str, inside: str = "") -> str:
    return f'<link name="{name}">{inside}</link>'


def collision(geometry: str) -> str:
    return f"<collision><geometry>{geometry}</geometry></collision>"


def joint(
    name: str,
    parent: str,
    child: str,
    type: str = "revolute",
    inside: str = '<axis xyz="0 0 1"/>',
    limit: str = LIMIT,
) -> str:
    return (
        f'<joint name="{name}" type="{type}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inside}{limit if type in ('revolute', 'prismatic') else ''}</joint>"
    )


def robot(*elements: str) -> str:
    """URDF text, one element a line (so that line n+1 is the n-th element's)."""
    return "\n".join(['<robot name="r">', *elements, "</robot>"])


def model_of(*elements: str, file: Path = Path("/tmp/r.urdf")) -> RobotModel:
    return parse_urdf(robot(*elements), file)


def with_limits(model: RobotModel, velocity: float = 2.0, acceleration: float = 5.0) -> RobotModel:
    """With velocity and acceleration limits for all joints, which a URDF does not have."""
    more = {"velocity": velocity, "acceleration": acceleration}
    joints = {n: replace(j, limits=replace(j.limits, **more)) for n, j in model.joints.items()}
    return replace(model, joints=joints)


def chain_of(*joints: str) -> RobotModel:
    """A chain of links l0, l1, ... joined by "type axis" joints j1, j2, ... each 0.3 m apart."""
    parts = [link("l0")]
    for i, words in enumerate(joints, start=1):
        type_, axis = words.split(" ", 1)
        parts.append(link(f"l{i}"))
        inside = f'<origin xyz="0.3 0 0" rpy="0.1 0.2 0.3"/><axis xyz="{axis}"/>'
        parts.append(joint(f"j{i}", f"l{i - 1}", f"l{i}", type_, inside))
    return model_of(*parts)


def dual() -> RobotModel:
    """Two ur10_gripper side by side, 1.5 m apart."""
    arm = load_robot("ur10_gripper")
    return compose(
        "dual",
        [
            MountedRobot(arm, "left_"),
            MountedRobot(arm, "right_", "world", SE3.from_xyz_rpy((0, -1.5, 0), (0, 0, 0))),
        ],
    )


def random_positions(model: RobotModel, rng: np.random.Generator) -> np.ndarray:
    low = np.where(np.isfinite(model.lower), model.lower, -np.pi)
    high = np.where(np.isfinite(model.upper), model.upper, np.pi)
    return rng.uniform(low, high)


def mbm_file(name: str) -> Path:
    return MBM / name / f"{name}.urdf"


@lru_cache
def mbm_robot(name: str) -> RobotModel:
    """A robot of MotionBenchMaker without its visuals, whose meshes are not there."""
    from lxml import etree

    root = etree.parse(str(mbm_file(name))).getroot()
    for visual in root.iter("visual"):
        visual.getparent().remove(visual)
    return parse_urdf(etree.tostring(root).decode(), mbm_file(name))


def pin_library(name: str) -> pin.Model:
    """A library robot as pinocchio reads it: its URDF, or its parts put together."""
    data = yaml.safe_load((LIBRARY / name / "robot.yaml").read_text())
    if "urdf" in data:
        file, args = resolve_uri(data["urdf"], LIBRARY / name), data.get("xacro_args")
        model = pin.buildModelFromXML(urdf_text(file, None, LIBRARY / name, xacro_texts(args, file)))
        for link, frame in (data.get("frames") or {}).items():
            parent = model.frames[model.getFrameId(frame["parent_link"], pin.FrameType.BODY)]
            T = SE3.from_mapping(frame["pose"])
            placed = parent.placement * pin.SE3(T.rotation.matrix, np.array(T.translation))
            model.addFrame(pin.Frame(link, parent.parentJoint, placed, pin.FrameType.BODY))
        return model
    model = pin.Model()
    if sum("parent_link" not in part for part in data["parts"]) > 1:  # ours get a root of their own
        model.addFrame(pin.Frame("world", 0, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    for part in data["parts"]:
        placed = SE3.from_mapping(part.get("pose", [0, 0, 0]))
        frame = model.getFrameId(part["parent_link"], pin.FrameType.BODY) if "parent_link" in part else 0
        own = LIBRARY / name / part["robot"]
        alone = pin.buildModelFromUrdf(str(own)) if own.is_file() else pin_library(part["robot"])
        other = _named(alone, part.get("prefix", ""))
        model = pin.appendModel(
            model, other, frame, pin.SE3(placed.rotation.matrix, np.array(placed.translation))
        )
    return model


def _named(model: pin.Model, prefix: str) -> pin.Model:
    """With a prefix before every name but the universe's."""
    for i in range(1, model.njoints):
        model.names[i] = prefix + model.names[i]
    for i in range(1, model.nframes):
        model.frames[i].name = prefix + model.frames[i].name
    return model


class PinRobot:
    """Pinocchio's kinematics asked in our terms. Its joints know no mimic: they get our full positions."""

    def __init__(self, pin_model: pin.Model, model: RobotModel):
        self.pin, self.model, self.data = pin_model, model, pin_model.createData()

    def configuration(self, full_positions: dict[str, float]) -> np.ndarray:
        q = pin.neutral(self.pin)
        for name, value in full_positions.items():
            i = self.pin.getJointId(name)
            at = self.pin.idx_qs[i]
            q[at : at + self.pin.nqs[i]] = (
                value if self.pin.nqs[i] == 1 else (np.cos(value), np.sin(value))
            )  # a continuous joint is a point on the circle
        return q

    def place(self, full_positions: dict[str, float]) -> None:
        pin.computeJointJacobians(self.pin, self.data, self.configuration(full_positions))
        pin.updateFramePlacements(self.pin, self.data)

    def pose(self, link: str) -> np.ndarray:
        """T_root_link (4, 4); our root may be below pinocchio's universe."""
        return (self.frame(self.model.root_link).inverse() * self.frame(link)).homogeneous

    def frame(self, link: str) -> pin.SE3:
        return self.data.oMf[self.pin.getFrameId(link, pin.FrameType.BODY)]

    def jacobian(self, link: str) -> np.ndarray:
        """(6, actuated joints) in our root frame, mimic joints added to those they follow."""
        J = pin.getFrameJacobian(
            self.pin,
            self.data,
            self.pin.getFrameId(link, pin.FrameType.BODY),
            pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
        )
        R = self.frame(self.model.root_link).rotation.T
        out = np.zeros((6, self.model.dof))
        for joint in self.model.joints.values():
            if not joint.movable:
                continue
            factor, source = 1.0, joint
            while source.mimic is not None:
                factor, source = factor * source.mimic.multiplier, self.model.joints[source.mimic.joint]
            column = J[:, self.pin.idx_vs[self.pin.getJointId(joint.name)]]
            out[:, self.model.joint_names.index(source.name)] += (
                factor * np.r_[R @ column[:3], R @ column[3:]]
            )
        return out


def references() -> dict[str, tuple]:
    """Name -> function that gives (our model, pinocchio's): the library and MotionBenchMaker."""
    found = {name: lambda n=name: (load_robot(n), pin_library(n)) for name in installed_robots()}
    for name in ("panda", "ur5", "baxter"):
        if mbm_file(name).exists():
            found[f"mbm_{name}"] = lambda n=name: (mbm_robot(n), pin.buildModelFromUrdf(str(mbm_file(n))))
    return found


REFERENCES = references()

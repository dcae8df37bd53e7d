"""Set up a robot from its URDF: groups, gripper, poses, the pairs of links that need no check.

From the command line:

    armcell setup my_robot.urdf -o my_cell
    armcell check my_cell

and here from Python, for a UR10 and for two of them in one cell.

    python examples/06_set_up_a_robot.py
"""

import tempfile
from collections import Counter
from pathlib import Path

import armcell
from armcell.cell import propose, write_cell
from armcell.core import InputError, NamedGoal, PlanRequest
from armcell.model import MoveItConfig, UrdfPart, find_file
from armcell.planning import plan

# Any URDF or xacro file will do; this one comes with the package example-robot-data.
urdf = find_file("package://example-robot-data/robots/ur_description/urdf/ur10_robot.urdf")

# What the assistant proposes. 100,000 samples are its default; a tenth of that is enough to look.
proposal = propose([UrdfPart(urdf)], samples=10_000)
model = proposal.model
for group in model.groups.values():
    states = ", ".join(model.named_states[group.name])
    print(f"group {group.name}: {len(group.joint_names)} joints to {group.tip_link}, states: {states}")
reasons = Counter(pair.reason or "to be checked" for pair in proposal.pairs)
print(", ".join(f"{count} {reason}" for reason, count in sorted(reasons.items())))
often = max((p for p in proposal.pairs if not p.reason), key=lambda pair: pair.touching)
share = 100 * often.touching / often.samples
print(f"most often in contact: {often.link_a} and {often.link_b}, in {share:.1f} % of the samples")

with tempfile.TemporaryDirectory() as folder:
    # The folder is a MoveIt package and a cell; written as a whole or not at all.
    write_cell(proposal, Path(folder, "ur10"))
    print("files:", " ".join(sorted(file.name for file in Path(folder, "ur10").rglob("*.*"))))

    # The cell plans at once.
    cell = armcell.load(Path(folder, "ur10"))
    result = plan(cell.scene(), PlanRequest("arm", (NamedGoal("ready"),)))
    print(f"to ready: {result.code.name}, {result.trajectory.duration:.1f} s")

    # MoveIt's files are read as they are, ours or another's.
    config = MoveItConfig.load(Path(folder, "ur10"))
    print("controllers:", ", ".join(config.controllers), "; planners:", len(config.planner_configs))

    # What is wrong in a file is named, with what exists.
    limits = Path(folder, "ur10", "config", "joint_limits.yaml")
    limits.write_text(limits.read_text().replace("elbow_joint", "elbo_joint"))
    try:
        MoveItConfig.load(Path(folder, "ur10"))
    except InputError as error:
        print("a typing error:", str(error).split("config/")[1])

    # Two robots with prefixes and places are one cell with two arms.
    left = UrdfPart(urdf, "left_", xyz=(0.0, 0.6, 0.0))
    right = UrdfPart(urdf, "right_", xyz=(0.0, -0.6, 0.0), rpy_deg=(0.0, 0.0, 180.0))
    write_cell(propose([left, right], samples=2_000), Path(folder, "two"))
    two = armcell.load(Path(folder, "two"))
    print("two arms:", ", ".join(two.model.groups))
    result = plan(two.scene(), PlanRequest("both_arms", (NamedGoal("ready"),)))
    print(f"both to ready: {result.code.name}, {len(result.trajectory.joint_names)} joints at once")

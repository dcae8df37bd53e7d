"""What can be asked of a planner: regions instead of poses, tolerances, a workspace, planners by name.

python examples/07_requests_and_pipelines.py
"""

from math import pi

import armcell
from armcell.core import (
    ADAPTERS,
    SE3,
    SO3,
    Box,
    ConstraintGoal,
    Constraints,
    InputError,
    JointConstraint,
    JointGoal,
    JointState,
    OrientationConstraint,
    PlanRequest,
    PoseGoal,
    PositionConstraint,
)
from armcell.planning import describe_violations, pipelines, plan
from armcell.scene import CollisionObject, PlanningScene

robot = armcell.load_robot("panda")
wall = CollisionObject.single("wall", Box(0.3, 0.02, 0.35), SE3.from_xyz(0.55, 0.0, 0.175))
beside = {"panda_joint1": -0.46, "panda_joint2": 0.3, "panda_joint4": -2.2, "panda_joint6": 2.5}
scene = PlanningScene.of(robot, objects=[wall]).with_state(JointState.from_mapping(beside))
down = SO3.from_rpy((pi, 0, 0))


def tell(what, result):
    detail = f"{result.trajectory.duration:.2f} s by {result.planner_id}" if result.ok else result.message
    print(f"{what:18s} {result.code.name}: {detail}")


# A pose inside the wall fails; a tolerance makes it a region, of which any free place will do.
inside = SE3(down, [0.55, 0.0, 0.25])
tell("exact pose", plan(scene, PlanRequest("arm", (PoseGoal(inside),))))
tell("within 15 cm", plan(scene, PlanRequest("arm", (PoseGoal(inside, position_tolerance=0.15),))))
round_tool = PoseGoal(SE3(down, [0.5, 0.3, 0.3]), orientation_tolerance=(0.01, 0.01, pi))  # z is free
tell("any turn about z", plan(scene, PlanRequest("arm", (round_tool,))))

# Constraint sets say only what matters: the tip in a box above the wall's far side, a joint in a range.
box = PositionConstraint(((Box(0.2, 0.2, 0.1), SE3.from_xyz(0.0, 0.25, 0.3)),), frame="wall")
upright = OrientationConstraint(down, (0.1, 0.1, pi))
wanted = Constraints((JointConstraint("panda_joint7", 0.5, 0.6, 0.6),), (box,), (upright,))
result = plan(scene, PlanRequest("arm", (ConstraintGoal(wanted),)))
tell("constraint set", result)
print(
    "at its end:",
    describe_violations(scene, "arm", wanted, result.trajectory.positions[-1]) or "all are kept",
)
print("at the start:", describe_violations(scene, "arm", wanted, scene.positions[:7]))

# Of four attempts side by side the shortest path; the tip in a box, and not faster than 0.2 m/s.
there = PoseGoal(SE3(down, [0.5, 0.3, 0.15]))
result = plan(scene, PlanRequest("arm", (there,), attempts=4, max_cartesian_speed=0.2,
                                 workspace=((0.0, -0.5, 0.0), (0.9, 0.6, 1.0))))  # fmt: skip
tell("four attempts", result)

# Planners by name, with parameters by their own names. What does not exist is said, with what does.
for pipeline, table in pipelines.items():
    print(f"{pipeline}: {', '.join(table)}")
request = PlanRequest("arm", (there,), pipeline_id="ompl", planner_id="geometric::KPIECE",
                      parameters={"goal_bias": 0.2})  # fmt: skip
tell("KPIECE of OMPL", plan(scene, request))
for wrong in ({"planner_id": "ESTkConfigDefault"}, {"parameters": {"goal_bais": 0.2}}):
    try:
        plan(scene, PlanRequest("arm", (there,), pipeline_id="ompl", **wrong))
    except InputError as error:
        print(error)

# A start slightly outside the limits is moved inside; one in contact is repaired if the request allows it.
# The result reports both.
start = JointState(("panda_joint7",), [robot.joint("panda_joint7").limits.upper + 0.02])
result = plan(scene, PlanRequest("arm", (JointGoal(JointState(("panda_joint7",), [1.0])),), start=start))
tell("start out of limits", result)
print("moved:", result.evidence["start_moved_within_limits"])
plate = CollisionObject.single(
    "plate", Box(0.3, 0.3, 0.02), scene.frame_pose("panda_hand_tcp").shifted(z=-0.018)
)
request = PlanRequest("arm", (there,), adapters=("fix_start_state_collision", *ADAPTERS))
result = plan(scene.with_object(plate), request)
tell("start in contact", result)
repaired = result.evidence["start_repaired"]
print(f"repaired: {repaired['contacts'][0].describe()}; {repaired['distance']:.3f} rad away is free, "
      f"the motion begins at the {repaired['begins_at']}")  # fmt: skip

"""The left arm holds a beam while the right arm screws a bolt into it in two strokes."""

from __future__ import annotations

from armcell.core import ErrorCode, JointGoal, JointState, Outcome
from armcell.tasks import checked

STROKES, TURNS, FORCE = 2, 0.75, 8.0  # strokes of the wrist, turns per stroke, pressing force [N]


def task(cell):
    left, right = cell["left_arm"], cell["right_arm"]
    checked(left.grasp("beam"))
    home = cell.model.named_state("right_arm", "home")
    ready = JointGoal(
        home.updated(JointState.from_mapping({"right_wrist_3_joint": -2.6}))
    )  # wrist turned back to start a stroke
    beam = cell.scene().object("beam").T_world_object
    done = []
    for _ in range(STROKES):
        checked(right.move_to(ready))
        checked(right.grasp("bolt"))
        done.append(checked(right.screw("bolt", TURNS, FORCE)).evidence)
        checked(right.let_go("bolt"))
    moved = 1000 * cell.scene().object("beam").T_world_object.distance_to(beam)[0]
    checked(right.move_to("home"))
    checked(left.let_go("beam"))
    checked(left.move_to("home"))
    turned, went_in = (sum(d[k] for d in done) for k in ("turned", "went_in_mm"))
    measures = {
        "turned": turned, "went_in_mm": went_in, "beam_moved_mm": moved,
        "force_mean_N": max(d["force_mean_N"] for d in done),
        "force_max_N": max(d["force_max_N"] for d in done),
    }  # fmt: skip
    good = abs(turned - STROKES * TURNS) <= 0.05 * STROKES * TURNS and moved <= 1.0
    text = "" if good else f"the bolt turned {turned:.2f} times and the beam moved {moved:.1f} mm"
    return Outcome(ErrorCode.SUCCESS if good else ErrorCode.CONTROL_FAILED, text, measures)

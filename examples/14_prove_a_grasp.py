"""Prove a grasp: quality by geometry, robustness against noise, and many small worlds that lift and shake."""

from dataclasses import replace

import armcell
from armcell.grasping import Noise, grasp_candidates, grasp_quality, hand_of, robustness
from armcell.scene import library_object
from armcell.tasks import distinct_grasps, prove_grasps

model = armcell.load("six_axis_pick").model  # a UR10 with a parallel gripper
gripper = model.gripper()
hand = hand_of(model, gripper)
bottle = library_object("bottle")

# --- six ways to hold a full bottle that differ
grasps, _ = grasp_candidates(bottle, hand)
some = distinct_grasps(grasps[:: max(1, len(grasps) // 24)], 6)
proofs = prove_grasps(model, gripper, bottle, some, trials=12)
print(f"{bottle.mass_kg:.2f} kg; grasp, force [N], epsilon, robustness, P(success) and its interval, slip")
for proof in proofs:
    grasp = proof.grasp
    quality, steady = grasp_quality(bottle, grasp), robustness(bottle, hand, grasp)
    low, high = proof.interval
    print(
        f"  {grasp.name:28s} {grasp.force:5.1f} {quality.epsilon:6.3f} {steady:5.2f} "
        f"  {proof.probability:.2f} [{low:.2f}, {high:.2f}]  {proof.slip * 1000:5.1f} mm"
    )

# --- how hard to grip: with a third of the force the same grasp lets go
best = max(proofs, key=lambda p: (p.successes, -p.slip)).grasp
for share in (1.0, 0.33, 0.1):
    (proof,) = prove_grasps(model, gripper, bottle, [replace(best, force=best.force * share)], trials=12)
    print(f"{best.force * share:5.1f} N per finger: {proof.successes} of {proof.trials} held")

# --- how well the pose has to be known
for position in (0.001, 0.004, 0.012):
    noise = Noise(position=position, rotation=0.02)
    (proof,) = prove_grasps(model, gripper, bottle, [best], trials=12, noise=noise)
    print(f"pose known to {position * 1000:.0f} mm: P(success) {proof.probability:.2f}")

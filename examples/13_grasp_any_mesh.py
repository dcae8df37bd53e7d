"""Grasp any mesh: a file in millimeters, how it can be held and why not otherwise, picked and placed."""

import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
import trimesh

import armcell
from armcell.core import SE3, InputError
from armcell.grasping import grasp_candidates, grasp_quality, hand_of, nearest_miss
from armcell.scene import library_object, mesh_object

cell = armcell.load("panda_pick")
gripper = cell.model.gripper()
hand = hand_of(cell.model, gripper)

with tempfile.TemporaryDirectory() as folder:
    # --- a part as a drawing programme writes it: a ring with a bar across, in millimeters
    ring = trimesh.creation.annulus(30, 45, 40)
    bar = trimesh.creation.box((64, 12, 20))
    part = trimesh.util.concatenate([ring, bar])
    part.export(Path(folder) / "wheel.stl")
    try:
        mesh_object("wheel", Path(folder) / "wheel.stl")
    except InputError as error:
        print("original mesh:", error.reason, "->", error.hint)
    wheel = mesh_object("wheel", Path(folder) / "wheel.stl", scale=0.001, density=400.0)
print(f"wheel: {wheel.mass_kg * 1000:.0f} g, {1000 * np.ptp(wheel.bounds(), axis=0)[0]:.0f} mm wide")

# --- where it can be held, the best first, and why not elsewhere
wheel = wheel.at(SE3.from_xyz(0.5, -0.2, 0.019))
grasps, rejected = grasp_candidates(wheel, hand)
print(f"{len(grasps)} grasps, {len(rejected)} rejected")
for grasp in grasps[:3]:
    quality = grasp_quality(wheel, grasp)
    print(
        f"  {grasp.name}: {grasp.width * 1000:.0f} mm between the pads, "
        f"opened to {grasp.opening * 1000:.0f} mm, {grasp.force:.1f} N, epsilon {quality.epsilon:.3f}"
    )
for reason, count in Counter(r.reason.split(":")[0].split(",")[-1] for r in rejected).most_common(3):
    print(f"  {count} x {reason.strip()}")

# --- an object that is too large says what came nearest
crate = library_object("box", "crate", sizes={"length": 0.3, "width": 0.2, "height": 0.25})
miss = nearest_miss(grasp_candidates(crate, hand)[1])
print(f"a crate: {miss.reason}")

# --- picked, held and placed in physics, by friction alone
scene = cell.scene().without_object("cube").with_object(wheel)
with cell.connect(scene=scene) as live:
    picked = live.arm.pick("wheel")
    if not picked:
        raise SystemExit(picked.message)
    print(f"pick: {picked.code.name}, {picked.evidence['grasp'].name}")
    live.arm.hold(2.0)
    print(f"slipped {1000 * live.reports[-1].slip_m:.2f} mm in 2 s")
    placed = live.arm.place("wheel", on="tray")
    target = placed.evidence["placement"].T_world_object
    off = target.distance_to(live.driver.object_poses()["wheel"])[0]
    print(f"place: {placed.code.name}, {1000 * off:.1f} mm off")

"""Do the collision kernel, the exact checker and physics agree on which regions of a mesh are solid?

    python -m benchmarks.solid_regions --poses 10000

A Panda's hand is at random poses around the first 20 meshes of the grasp benchmark (`grasp_objects.py`), with
random openings. At each pose all three say whether the hand touches the object, and the exact checker and
physics how far it is away or inside. Two of them disagree beyond 1 mm if one says "touches" where the other
measures a gap above 1 mm. The table also compares the volume of a mesh with that of its convex pieces.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import replace

import mujoco
import numpy as np

from armcell.collision import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.object_decomposition import object_pieces
from armcell.core import SE3, SO3, Mesh
from armcell.grasping import surface_of
from armcell.kinematics import kinematic_tree
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import PhysicsSettings
from armcell.sim.mujoco_model import build
from benchmarks.grasp_objects import listed, load

MESHES = 20
LIMIT = 0.001  # [m]
AWAY = 0.02  # [m] standard deviation of the distance between the tcp and a random surface point
MARGIN = 0.003  # [m] distance up to which physics reports a gap
CASES = ("kernel, exact", "exact, kernel", "physics, exact", "exact, physics", "physics, kernel")


def compare(item: CollisionObject, poses: int, seed: int) -> Counter[str]:
    """Count the poses of a hand around an object, those in contact, and each kind of disagreement.

    The key "a, b" counts poses that a calls a contact although b says that the hand is free: b measures a gap
    beyond the limit. The kernel measures no gap; for it, the other one measures a depth beyond the limit.
    """
    model = load_robot("panda")
    scene, tree = PlanningScene.of(model), kinematic_tree(model)
    gripper, rng, counts = model.gripper(), np.random.default_rng(seed), Counter({"poses": poses})
    q = np.array(scene.positions)
    fingers = model.columns(gripper.joint_names)
    item = replace(item, name="object", movable=True)
    built = build(scene.with_object(item.at(SE3.from_xyz(2, 0, 2))), PhysicsSettings())
    mj, data = built.mj, mujoco.MjData(built.mj)
    mj.geom_margin[:] = MARGIN
    start, body = built.object_qpos["object"], built.body["object"]
    surface = surface_of(item)
    for _ in range(poses):
        q[fingers] = gripper.joint_position(rng.uniform(0.0, gripper.max_width))
        T_tcp_object = SE3(SO3.exp(rng.normal(size=3) * 2), np.zeros(3))
        point = surface.points[rng.integers(len(surface.points))]
        T_tcp_object = SE3(
            T_tcp_object.rotation, rng.normal(size=3) * AWAY - T_tcp_object.rotation.matrix @ point
        )
        T = tree.link_pose(q, gripper.tcp_link) @ T_tcp_object
        placed = scene.with_object(item.at(T))
        kernel = KernelChecker(placed, model.joint_names).touches(q)
        exact = _exact_distance(ExactChecker(placed, model.joint_names), q)
        data.qpos[built.qpos] = q
        for address, weight in built.grippers[gripper.name].joints:
            data.qpos[address] = q[fingers[0]] / (len(built.grippers[gripper.name].joints) * weight)
        data.qpos[start : start + 3], data.qpos[start + 3 : start + 7] = T.translation, T.quat_wxyz
        mujoco.mj_forward(mj, data)
        physics = _physics_distance(mj, data, body)
        counts["touching"] += exact <= 0
        counts["kernel, exact"] += kernel and exact > LIMIT
        counts["exact, kernel"] += not kernel and exact < -LIMIT
        counts["physics, exact"] += physics <= 0 and exact > LIMIT
        counts["exact, physics"] += exact <= 0 and physics > LIMIT
        counts["physics, kernel"] += not kernel and physics < -LIMIT
    return counts


def _exact_distance(checker: ExactChecker, q: np.ndarray) -> float:
    checker.set_configuration(q)
    item = [i for i, g in enumerate(checker.geometries) if g.body == "object"]
    links = [i for i, g in enumerate(checker.geometries) if g.link >= 0]
    pairs = np.array([(a, b) for a in links for b in item])
    gaps = checker.pair_gaps(pairs)
    return min((checker.pair_distance(a, b) for a, b in pairs[gaps < 0.05].tolist()), default=np.inf)


def _physics_distance(mj: mujoco.MjModel, data: mujoco.MjData, body: int) -> float:
    owners = mj.geom_bodyid[data.contact.geom]
    of_object = (owners == body).any(axis=1)
    return float(data.contact.dist[of_object].min(initial=np.inf))


def volumes(item: CollisionObject) -> tuple[float, float]:
    """Return the volumes [cm3] of a mesh and of its convex pieces in physics."""
    (shape, _), *_ = item.shapes
    assert isinstance(shape, Mesh)
    pieces = sum(map(_volume, object_pieces(shape)))
    return item.volume * 1e6, pieces * 1e6


def _volume(piece: Mesh) -> float:
    a, b, c = (piece.vertices[piece.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--poses", type=int, default=10_000, help="of all meshes together")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    total: Counter[str] = Counter()
    print("| mesh | volume | of the convex pieces | ratio | poses | touching | "
          + " | ".join(f"{case.replace(', ', ' touches, ')} free" for case in CASES) + " |")  # fmt: skip
    print("|" + "---|" * (6 + len(CASES)))
    for entry in listed()[:MESHES]:
        item = load(entry)
        counts = compare(item, given.poses // MESHES, given.seed)
        mesh, pieces = volumes(item)
        print(
            f"| {entry.name} | {mesh:.0f} cm3 | {pieces:.0f} cm3 | {pieces / mesh:.2f} | {counts['poses']} "
            f"| {counts['touching']} | " + " | ".join(str(counts[case]) for case in CASES) + " |",
            flush=True,
        )
        total += counts
    worst = max(total[case] for case in CASES)
    print(f"{total['poses']} poses, {total['touching']} in contact; disagreement beyond 1 mm: "
          + "; ".join(f"{c.replace(', ', ' touches, ')} free {total[c]}" for c in CASES))  # fmt: skip
    return 0 if worst <= 0.01 * total["poses"] else 1


if __name__ == "__main__":
    sys.exit(main())

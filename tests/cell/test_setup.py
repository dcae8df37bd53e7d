"""What the set-up assistant writes: checked by other readers and another collision library; planned in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import pytest
import yaml
from tests.cell.starter import check_starter
from tests.cell.written import Written
from tests.model.helpers import EXAMPLES, MBM, collision, joint, link, robot
from tests.once import once

import armcell
from armcell.cell.setup import SetupProposal, cell_files, propose, propose_from_package, write_cell
from armcell.cell.setup_poses import with_poses
from armcell.cli.new import write_starter
from armcell.collision import ExactChecker
from armcell.collision.self_collision import link_pairs
from armcell.core import Cylinder, InputError, NamedGoal, PlanRequest
from armcell.model import Gripper, MoveItConfig, load_robot, parse_urdf
from armcell.model.setup import UrdfPart, srdf_of, srdf_text, with_groups
from armcell.model.setup.gripper_detection import GripperSpec
from armcell.model.srdf import with_srdf_text
from armcell.model.urdf_writer import urdf_of
from armcell.planning import plan

ROBOTS = {
    "panda": EXAMPLES / "panda_description/urdf/panda.urdf",
    "ur10": EXAMPLES / "ur_description/urdf/ur10_robot.urdf",
    "ur5": MBM / "ur5/ur5.urdf",  # with a Robotiq 85
    "baxter": EXAMPLES / "baxter_description/urdf/baxter.urdf",
}
SHARED = Path(__file__).parents[3].joinpath("shared", "data", "robots").resolve()
SLOW = {"ur5", "baxter"}
NAMES = [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in ROBOTS]
SAMPLES = 5_000  # for the pairs; `armcell setup` takes 100,000
CHECKED = 500  # by the other collision library; 100,000 are in docs/setup.md

BOX = collision('<box size="0.05 0.05 0.05"/>')


@pytest.fixture(scope="module")
def proposed(tmp_path_factory) -> Callable[[str], SetupProposal]:
    @lru_cache
    def of(name: str) -> SetupProposal:
        if not ROBOTS[name].exists():
            pytest.skip(f"{ROBOTS[name]} is not there")
        return once(tmp_path_factory, f"proposal-{name}", lambda: propose([UrdfPart(ROBOTS[name])], SAMPLES))

    return of


def small_arm(folder: Path, name: str = "small") -> Path:
    """A URDF of three joints, primitives only."""
    parts = [link("l0", BOX)]
    for i in (1, 2, 3):
        parts += [link(f"l{i}", BOX)]
        inside = '<origin xyz="0.2 0 0"/><axis xyz="0 0 1"/>'
        parts += [joint(f"j{i}", f"l{i - 1}", f"l{i}", inside=inside)]
    file = folder / f"{name}.urdf"
    file.write_text(robot(*parts))
    return file


@pytest.mark.slow
@pytest.mark.cases("panda")
@pytest.mark.parametrize("name", ROBOTS)
def test_ignored_pairs_never_touch_or_always(name, tmp_path, proposed):
    write_cell(proposed(name), tmp_path / "cell")
    written = Written(tmp_path / "cell")
    counts = written.count(CHECKED, seed=99)
    reasons = {r for _, _, r in written.disabled}
    assert {"Adjacent", "Never"} <= reasons <= {"Adjacent", "Never", "Always", "Default"}
    for a, b, reason in written.disabled:
        if reason == "Never":
            assert counts[a, b] == 0, (a, b)
        elif reason == "Always":
            assert counts[a, b] == CHECKED, (a, b)


@pytest.mark.slow
@pytest.mark.cases("panda", "ur5")
@pytest.mark.parametrize("name", NAMES)
def test_what_touches_is_checked(name, proposed):
    """The other way round, by the exact checker: every pair seen in contact is not ignored as "Never"."""
    model = proposed(name).model
    counts = {p.links: p for p in proposed(name).pairs}
    for pair, reason in model.disabled_collisions.items():
        if reason == "Default":  # only a gripper's own fingers
            hands = [set(model.groups[e.group].link_names) for e in model.end_effectors.values()]
            assert any(pair <= hand for hand in hands), pair
    checked = [p for p in counts.values() if not p.reason]
    assert checked and all(p.touching < p.samples for p in checked)


@pytest.mark.slow
@pytest.mark.cases("panda", "ur5")
@pytest.mark.parametrize("name", NAMES)
def test_a_written_cell_plans_at_once(name, tmp_path, proposed):
    write_cell(proposed(name), tmp_path / "cell")
    cell = armcell.load(tmp_path / "cell")
    scene = cell.scene()
    assert ExactChecker(scene).contacts(scene.positions) == []
    moved = 0
    for group, states in cell.model.named_states.items():
        for state in states:
            result = plan(scene, PlanRequest(group, (NamedGoal(state),)))
            assert result.ok, (group, state, result.message)
            goal = cell.model.named_state(group, state)
            assert result.path.waypoints[-1] == pytest.approx(goal.positions, abs=1e-6)
            moved += len(result.path.waypoints) > 1
    assert moved


@pytest.mark.cases("panda", "ur5")
@pytest.mark.parametrize("name", NAMES)
def test_moveit_reads_the_same(name, tmp_path, proposed):
    """A round trip: the files read as a MoveIt package give the model that was proposed."""
    write_cell(proposed(name), tmp_path / "cell")
    config, model = MoveItConfig.load(tmp_path / "cell"), proposed(name).model
    for group, old in model.groups.items():
        new = config.model.groups[group]
        assert (new.joint_names, set(new.link_names)) == (old.joint_names, set(old.link_names))
    assert config.model.disabled_collisions == model.disabled_collisions
    assert config.model.end_effectors == model.end_effectors
    assert list(config.model.joints) == list(model.joints)
    assert set(config.group_planning) == {g.name for g in model.groups.values() if g.joint_names}
    joints = {j for c in config.controllers.values() for j in c["joints"]}
    assert joints == {j for g in model.groups.values() for j in g.joint_names}
    loaded = load_robot(tmp_path / "cell")
    assert loaded.grippers == model.grippers
    config.write(tmp_path / "again")
    again = MoveItConfig.load(tmp_path / "again")
    assert again.srdf == config.srdf and again.files == config.files


def test_a_gripper_measured_on_the_meshes_is_the_library_s(proposed):
    found, known = proposed("panda").model.gripper(), load_robot("panda").gripper()
    for field in ("tcp_link", "finger_links", "width_per_joint", "hand_links", "joint_name"):
        assert getattr(found, field) == getattr(known, field), field
    assert found.max_width == pytest.approx(known.max_width, abs=1e-3)
    assert found.pad_depth == pytest.approx(known.pad_depth, abs=1e-3)
    assert found.finger_depth == pytest.approx(known.finger_depth, abs=5e-3)


@pytest.mark.long
@pytest.mark.parametrize(
    "file", [SHARED / "so101/Simulation/SO101/so101_new_calib.urdf", EXAMPLES / "z1_description/urdf/z1.urdf"]
)
def test_one_moving_jaw_picks_and_places(file, tmp_path):
    """The jaws hold the cube at an angle: an arm with five joints places it only at certain angles."""
    if not file.exists():
        pytest.skip(f"{file} is not there")
    proposal = propose([UrdfPart(file)], SAMPLES)
    write_cell(proposal, tmp_path)
    assert write_starter(load_robot(tmp_path), ".", tmp_path)
    check_starter(tmp_path)


@pytest.mark.slow
def test_suction_cups_pick_and_place(tmp_path):
    """A UR10 with two cups whose shapes end at the free lip, as in vendors' descriptions."""
    model = load_robot("ur10_suction")
    longer = {
        name: replace(
            link, collisions=tuple(replace(c, shape=Cylinder(0.02, 0.042)) for c in link.collisions)
        )
        for name, link in model.links.items()
        if name.endswith("_cup")
    }
    file = tmp_path / "ur10_cups.urdf"
    file.write_text(urdf_of(replace(model, links={**model.links, **longer})))
    proposal = propose([UrdfPart(file)], SAMPLES, grippers=[GripperSpec.parse("suction")])
    write_cell(proposal, tmp_path / "cell")
    assert write_starter(load_robot(tmp_path / "cell"), ".", tmp_path / "cell")
    check_starter(tmp_path / "cell")


@pytest.mark.long
def test_two_arms_in_one_go(tmp_path):
    file = ROBOTS["ur10"]
    parts = [UrdfPart(file, "left_", (0, 0.6, 0)), UrdfPart(file, "right_", (0, -0.6, 0), (0, 0, 90))]
    proposal = propose(parts, 3000)
    assert set(proposal.model.groups) == {"left_arm", "right_arm", "both_arms"}
    write_cell(proposal, tmp_path / "two")
    model = armcell.load(tmp_path / "two").model
    assert model.root_link == "world" and model.dof == 12
    # The arms can meet, so pairs across them are checked; one arm's pairs are those of one arm.
    across = [p for p in proposal.pairs if p.link_a.startswith("left_") != p.link_b.startswith("left_")]
    assert any(p.touching for p in across if not p.reason)
    result = plan(armcell.load(tmp_path / "two").scene(), PlanRequest("both_arms", (NamedGoal("ready"),)))
    assert result.ok, result.message
    from armcell.kinematics import kinematic_tree

    T = kinematic_tree(model).link_pose(model.neutral(), "right_base_link")
    assert T.translation == pytest.approx([0, -0.6, 0]) and T.rotation.rpy[2] == pytest.approx(1.5707963)


def test_a_moveit_package_becomes_a_cell(tmp_path):
    write_cell(propose([UrdfPart(small_arm(tmp_path))], 500), tmp_path / "first")
    for extra in ("robot.yaml", "cell.yaml"):
        (tmp_path / "first" / extra).unlink()
    write_cell(propose_from_package(tmp_path / "first"), tmp_path / "second")
    cell = armcell.load(tmp_path / "second")
    assert plan(cell.scene(), PlanRequest("arm", (NamedGoal("ready"),))).ok
    for file in (tmp_path / "first" / "config").glob("*.yaml"):
        again = (tmp_path / "second" / "config" / file.name).read_text()
        assert yaml.safe_load(again) == yaml.safe_load(file.read_text())


def test_the_same_seed_gives_the_same_files(tmp_path):
    file = small_arm(tmp_path)
    assert cell_files(propose([UrdfPart(file)], 500, 3), "c") == cell_files(
        propose([UrdfPart(file)], 500, 3), "c"
    )


@pytest.mark.parametrize("is_known", (False, True))
def test_states_at_the_end_of_a_range_stay_within_limits_when_written(is_known):
    """Limits of 30 and 150 degrees with twelve digits, as in the fingers of TIAGo's hand."""
    limit = '<limit lower="-0.523598775598" upper="2.61799387799" velocity="1" effort="1"/>'
    box = collision('<box size="0.02 0.02 0.1"/>')
    fingers = [part for n in "ab"[is_known:] for part in (link(n, box), joint(f"f{n}", "l3", n, limit=limit))]
    rows = [part for i in range(1, 4) for part in (link(f"l{i}", box), joint(f"j{i}", f"l{i - 1}", f"l{i}"))]
    model = with_groups(parse_urdf(robot(link("l0"), *rows, *fingers), Path("r.urdf")), jaws=("fa", "fb"))
    if is_known:
        gripper = Gripper(
            name="gripper", arm_group="arm", group="gripper", joint_name="fb", tcp_link="l3",
            finger_links=("l3", "b"), hand_links=("l3", "b"), width_per_joint=0.1, max_width=0.261799387799,
        )  # fmt: skip
        model = replace(model, grippers={"gripper": gripper})
    model = with_poses(model)
    read = with_srdf_text(model, srdf_text(srdf_of(model)), Path("r.srdf"))
    for name in ("open", "close"):
        state = read.named_state("gripper", name)
        read.check_positions(state.positions, state.joint_names)


def test_a_search_finds_contact_that_samples_missed():
    """Two links of a row that meet only where a joint is at the end of its range."""
    ball = collision('<sphere radius="0.05"/>')
    tip = '<collision><origin xyz="0.3 0 0"/><geometry><sphere radius="0.052"/></geometry></collision>'
    limit = '<limit lower="0" upper="{}" velocity="1" effort="1"/>'
    # Three joints between l0 and l3, so that no proof is tried; only the end of c's range brings them near.
    away = '<collision><origin xyz="0 0 1"/><geometry><sphere radius="0.01"/></geometry></collision>'
    above = '<origin xyz="-0.2 0 0"/><axis xyz="0 0 1"/>'
    turned = '<origin rpy="0 0 -1.5"/><axis xyz="0 0 1"/>'
    text = robot(
        link("l0", ball), link("l1", away), link("l2", away), link("l3", tip),
        joint("a", "l0", "l1", inside=above, limit=limit.format(0.02)),
        joint("b", "l1", "l2", limit=limit.format(0.02)),
        joint("c", "l2", "l3", inside=turned, limit=limit.format(1.45)),
    )  # fmt: skip
    found = {pair.links: pair for pair in link_pairs(parse_urdf(text, Path("row.urdf")), 12, seed=2)}
    pair = found[frozenset(("l0", "l3"))]
    assert pair.touching == 0 and not pair.reason


def test_pairs_can_be_chosen_by_hand(tmp_path):
    proposal = propose([UrdfPart(small_arm(tmp_path))], 500)
    pair = frozenset(("l0", "l1"))
    without = proposal.without(pair)
    assert pair not in without.model.disabled_collisions
    assert without.disabling(pair).model.disabled_collisions[pair] == "Adjacent"


@pytest.mark.parametrize(
    ("prefixes", "message"),
    [(("", ""), "not all different"), (("left_", "left_"), "not all different")],
)
def test_robots_that_clash(tmp_path, prefixes, message):
    file = small_arm(tmp_path)
    with pytest.raises(InputError, match=message):
        propose([UrdfPart(file, p) for p in prefixes], 100)


def test_nothing_half_written(tmp_path, monkeypatch):
    proposal = propose([UrdfPart(small_arm(tmp_path))], 500)
    write_cell(proposal, tmp_path / "cell")
    before = {f: f.read_bytes() for f in (tmp_path / "cell").rglob("*") if f.is_file()}
    with pytest.raises(InputError, match="not empty"):
        write_cell(proposal, tmp_path / "cell")
    (tmp_path / "cell" / "mine.txt").write_text("kept")
    real = Path.write_text

    def fails(self, *args, **kwargs):
        if self.name == "cell.yaml":
            raise OSError("disk full")
        return real(self, *args, **kwargs)

    monkeypatch.setattr(Path, "write_text", fails)
    with pytest.raises(OSError, match="disk full"):
        write_cell(proposal, tmp_path / "cell", force=True)
    assert {f: f.read_bytes() for f in before} == before
    monkeypatch.undo()
    write_cell(proposal, tmp_path / "cell", force=True)
    assert (tmp_path / "cell" / "mine.txt").read_text() == "kept"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cell", "small.urdf"]  # nothing temporary is left

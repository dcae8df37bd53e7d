"""Poses of random SDF worlds against libsdformat, Gazebo's own parser (Debian: libsdformat-dev)."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from armcell.core import SE3, Box
from armcell.scene.sdf import load_sdf

pytestmark = pytest.mark.interop

REFERENCE = r"""
#include <iostream>
#include <sdf/sdf.hh>
using ignition::math::Pose3d;

void Print(const sdf::Model *model, const Pose3d &parent) {
  Pose3d pose;
  for (const auto &e : model->SemanticPose().Resolve(pose)) std::cerr << e.Message() << "\n";
  pose = parent * pose;
  for (uint64_t i = 0; i < model->LinkCount(); ++i) {
    const auto *link = model->LinkByIndex(i);
    Pose3d at;
    for (const auto &e : link->SemanticPose().Resolve(at)) std::cerr << e.Message() << "\n";
    for (uint64_t k = 0; k < link->CollisionCount(); ++k) {
      const auto *collision = link->CollisionByIndex(k);
      Pose3d in;
      for (const auto &e : collision->SemanticPose().Resolve(in)) std::cerr << e.Message() << "\n";
      const Pose3d p = pose * at * in;
      std::cout << collision->Geom()->BoxShape()->Size().X() << " " << p.Pos() << " " << p.Rot().X() << " "
                << p.Rot().Y() << " " << p.Rot().Z() << " " << p.Rot().W() << "\n";
    }
  }
  for (uint64_t i = 0; i < model->ModelCount(); ++i) Print(model->ModelByIndex(i), pose);
}

int main(int, char **argv) {
  std::cout.precision(17);
  std::cerr.precision(17);
  sdf::ParserConfig config;
  const std::string folder = argv[2];
  config.SetFindCallback([&](const std::string &uri) { return folder + "/" + uri; });
  config.AddURIPath("model://", folder);
  sdf::Root root;
  const auto errors = root.Load(argv[1], config);
  for (const auto &e : errors) std::cerr << e.Message() << "\n";
  if (!errors.empty()) return 1;
  const auto *world = root.WorldByIndex(0);
  for (uint64_t i = 0; i < world->ModelCount(); ++i) Print(world->ModelByIndex(i), Pose3d::Zero);
  return 0;
}
"""
INCLUDED = """<sdf version="1.9"><model name="part" placement_frame="grip"><pose>9 9 9 0 0 0</pose>
<frame name="grip" attached_to="b"><pose>0.1 0.2 0.3 0.4 0.5 0.6</pose></frame>
<link name="a"><collision name="c"><geometry><box><size>{size} 1 1</size></box></geometry></collision></link>
<link name="b"><pose relative_to="a">0.3 0 0 0 1 0</pose></link></model></sdf>"""


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    if not all(shutil.which(tool) for tool in ("g++", "pkg-config")):
        pytest.skip("g++ and pkg-config are not installed (apt-get install g++ pkg-config libsdformat-dev)")
    flags = subprocess.run(["pkg-config", "--cflags", "--libs", "sdformat12"], capture_output=True, text=True)
    if flags.returncode:
        pytest.skip("libsdformat is not installed (apt-get install libsdformat-dev)")
    folder = tmp_path_factory.mktemp("reference")
    (folder / "poses.cc").write_text(REFERENCE)
    command = ["g++", "-std=c++17", "poses.cc", "-o", "poses", *flags.stdout.split()]
    subprocess.run(command, cwd=folder, check=True, timeout=300)
    return folder / "poses"


class Drawn:
    """A random world: each collision is a box whose first size says which one it is."""

    def __init__(self, seed: int):
        self.rng, self.boxes, self.names = np.random.default_rng(seed), 0, 0

    def name(self, kind: str) -> str:
        self.names += 1
        return f"{kind}{self.names}"

    def pose(self, frames: list[str]) -> str:
        where = f' relative_to="{self.rng.choice(frames)}"' if frames and self.rng.random() < 0.6 else ""
        xyz, form = self.rng.normal(size=3), self.rng.integers(3)
        if form == 0:
            quat = self.rng.normal(size=4)
            values = _text([*xyz, *quat / np.linalg.norm(quat)])
            return f'<pose{where} rotation_format="quat_xyzw">{values}</pose>'
        rpy = self.rng.uniform(-3, 3, 3)
        degrees = ' degrees="true"' if form == 1 else ""
        return f"<pose{where}{degrees}>{_text([*xyz, *(np.rad2deg(rpy) if form == 1 else rpy)])}</pose>"

    def link(self, name: str, frames: list[str]) -> str:
        text = f'<link name="{name}">{self.pose(frames)}'
        for _ in range(self.rng.integers(1, 3)):
            self.boxes += 1
            size = f"<geometry><box><size>{self.boxes} 1 1</size></box></geometry>"
            text += f'<collision name="{self.name("c")}">{self.pose(frames)}{size}</collision>'
        return text + "</link>"

    def model(self, depth: int, outside: list[str]) -> tuple[str, str, list[str]]:
        """Name, text, and the names by which frames in it are known outside."""
        name, frames, text = self.name("m"), ["__model__"], ""
        for _ in range(self.rng.integers(1, 4)):
            link = self.name("l")
            text += self.link(link, frames)
            frames.append(link)
        if len(frames) > 2:
            joint = self.name("j")
            text += (
                f'<joint name="{joint}" type="fixed"><parent>{frames[1]}</parent><child>{frames[2]}</child>'
            )
            text += f"{self.pose([])}</joint>"
            frames.append(joint)
        frame = self.name("f")
        attached = f' attached_to="{self.rng.choice(frames[1:])}"' if self.rng.random() < 0.5 else ""
        text += f'<frame name="{frame}"{attached}>{self.pose(frames)}</frame>'
        frames.append(frame)
        if depth < 2 and self.rng.random() < 0.7:
            inner, more, names = self.model(depth + 1, frames)
            text += more
            frames += [inner, *names]
        placed = f' placement_frame="{self.rng.choice(frames[1:])}"' if self.rng.random() < 0.3 else ""
        text = f'<model name="{name}"{placed}>{self.pose(outside)}{text}</model>'
        return name, text, [f"{name}::{f}" for f in frames[1:]]

    def world(self) -> str:
        frames, text = ["world"], ""
        for _ in range(3):
            name, more, names = self.model(0, frames)
            text += more
            frames += [name, *names]
        frame = self.name("f")
        text += f'<frame name="{frame}">{self.pose(frames)}</frame>'
        pose = self.pose([*frames, frame])
        text += f"<include><uri>model://part</uri><name>included</name>{pose}</include>"
        head = "<?xml version='1.0'?>"
        return f'{head}<sdf version="1.9"><world name="w">{text}</world></sdf>'


def _text(values) -> str:
    return " ".join(repr(float(v)) for v in values)


@pytest.mark.parametrize("seed", range(12))
def test_poses_are_libsdformat_s(reference, tmp_path, seed):
    drawn = Drawn(seed)
    world = tmp_path / "w.sdf"
    world.write_text(drawn.world())
    part = tmp_path / "part"
    part.mkdir()
    (part / "model.sdf").write_text(INCLUDED.format(size=drawn.boxes + 1))
    (part / "model.config").write_text("<model><name>part</name><sdf version='1.9'>model.sdf</sdf></model>")
    said = subprocess.run([reference, world, tmp_path], capture_output=True, text=True, timeout=60)
    assert said.returncode == 0, said.stderr
    theirs = {}
    for line in said.stdout.splitlines():
        box, *values = map(float, line.split())
        theirs[int(box)] = SE3.from_quat_xyzw(values[:3], values[3:])
    ours = {}
    for item in load_sdf(world).objects:
        for shape, T in item.shapes:
            assert isinstance(shape, Box)
            ours[int(shape.x)] = item.T_world_object @ T
    assert set(ours) == set(theirs) == set(range(1, drawn.boxes + 2))
    for box, T in theirs.items():
        assert ours[box].isclose(T, 1e-6, 1e-6), f"box {box}: {ours[box]} {T}\n{Path(world).read_text()}"

"""What armcell reads from files and from wires: a target per parser, each with valid inputs to damage.

A target's `take` does what a program does with the input. It may raise armcell's own errors; anything else is
a fault.
"""

from __future__ import annotations

import gzip
import io
import json
import shutil
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
SEEDS = HERE / "seeds"
CONFIG = (
    "two.srdf", "joint_limits.yaml", "kinematics.yaml", "ompl_planning.yaml", "sensors_3d.yaml",
    "moveit_controllers.yaml", "pilz_cartesian_limits.yaml",
)  # fmt: skip


@dataclass(frozen=True)
class Target:
    """One parser.

    Attributes:
        file: where an input is written, below the target's folder.
        seeds: valid inputs.
        take: reads the file.
    """

    name: str
    file: str
    seeds: tuple[bytes, ...]
    take: Callable[[Path], Any]

    def folder(self, within: Path) -> Path:
        """A new folder with what inputs refer to."""
        folder = within / self.name
        shutil.copytree(SEEDS, folder, dirs_exist_ok=True)
        (folder / "config").mkdir(exist_ok=True)
        for name in (*CONFIG, "two.urdf", "part.obj"):
            shutil.copy(SEEDS / name, folder / "config")
        return folder


def seed(name: str) -> bytes:
    return (SEEDS / name).read_bytes()


def forget() -> None:
    """Empty the caches that go by a file's name: every input has the name of the one before."""
    from armcell.model import assets

    assets.load_mesh.cache_clear()
    assets.load_visual_parts.cache_clear()


# --- robots and cells ---
def urdf(path: Path) -> None:
    from armcell.kinematics import kinematic_tree
    from armcell.model.urdf import load_urdf

    model = load_urdf(path)
    kinematic_tree(model).link_transforms(np.zeros(model.dof))


def srdf(path: Path) -> None:
    from armcell.model.srdf import with_srdf

    with_srdf(_two(), path)


@cache
def _two() -> Any:
    from armcell.model.urdf import load_urdf

    return load_urdf(SEEDS / "two.urdf")


def joint_limits(path: Path) -> None:
    from armcell.model.limits import with_joint_limits

    with_joint_limits(_two(), path)


def package(path: Path) -> None:
    from armcell.model.setup.moveit_config import MoveItConfig

    found = MoveItConfig.load(path.parent.parent)
    for name in ("planner_configs", "group_planning", "controllers", "kinematics", "cartesian_limits"):
        getattr(found, name)


def robot(path: Path) -> None:
    from armcell.model import load_robot

    load_robot(path.parent)


def cell(path: Path) -> None:
    from armcell.cell import load

    load(path).scene(3)


def objects(path: Path) -> None:
    from armcell.cell.objects_file import load_objects

    load_objects(path)


def gains(path: Path) -> None:
    from armcell.model import load_robot
    from armcell.sim import PhysicsSettings
    from armcell.sim.gain_files import with_gains

    with_gains(PhysicsSettings(), path, load_robot(path.parent))


def sdf(path: Path) -> None:
    from armcell.cell.world_import import import_world, write_imported

    world = import_world(path)
    if world.objects:
        write_imported(world.objects, path.parent / "imported.yaml", None, force=True)


def sdf_included(path: Path) -> None:
    from armcell.scene.sdf import load_sdf

    load_sdf(path.parents[2] / "cell.world")


# --- geometry ---
def mesh(path: Path) -> None:
    from armcell.core import SE3
    from armcell.model.assets import load_mesh, load_visual_parts
    from armcell.scene import CollisionObject

    found = load_mesh(path)
    assert np.isfinite(found.vertices).all()
    assert found.faces.min() >= 0 and found.faces.max() < len(found.vertices)
    CollisionObject.single("part", found, SE3.identity())
    for part, _ in load_visual_parts(path):
        assert np.isfinite(part.vertices).all() and part.faces.max() < len(part.vertices)


def cloud(path: Path) -> None:
    from armcell.scene import load_obstacle

    load_obstacle(path, None if path.suffix == ".npz" else 0.01)


def octomap(path: Path) -> None:
    from armcell.scene.octree_file import load_octree

    load_octree(path)


def scene_file(path: Path) -> None:
    from armcell.scene.scene_file import load_scene_file

    load_scene_file(path)


@cache
def _octree(full: bool) -> bytes:
    import tempfile

    from armcell.core import Octree
    from armcell.scene.octree_file import save_octree

    if full:
        nodes = b"".join(struct.pack("<fB", 0.85, children) for children in (1, 2, 0))
        return b"# Octomap OcTree file\nid OcTree\nsize 3\nres 0.1\ndata\n" + nodes
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "map.bt"
        save_octree(Octree.from_grid(np.arange(8).reshape(2, 2, 2) % 3 > 0, 0.1), file)
        return file.read_bytes()


@cache
def _mesh_as(kind: str) -> bytes:
    import trimesh

    box = trimesh.creation.box((0.1, 0.2, 0.3))
    data = box.export(file_type=kind)
    return data if isinstance(data, bytes) else data.encode()


@cache
def _cloud_as(kind: str) -> bytes:
    points = np.random.default_rng(1).normal(size=(6, 3))
    file = io.BytesIO()
    if kind == "npy":
        np.save(file, points)
    elif kind == "npz":
        np.savez(file, centers=points, sizes=np.full(6, 0.1))
    else:
        head = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 6\n"
        head += "HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 6\nDATA binary\n"
        file.write(head.encode() + points.astype("<f4").tobytes())
    return file.getvalue()


# --- records, pictures, campaigns ---
def record(path: Path) -> None:
    from armcell.records import read_record

    found = read_record(path)
    for state in found.states:
        state.sample()


def bag(path: Path) -> None:
    from armcell.perception.bag import load_record

    load_record(path)


@cache
def _record() -> bytes:
    """A short run of a small robot."""
    import tempfile

    from armcell.core import Event, JointState, JointTrajectory, StateSample
    from armcell.records import RunRecorder, run_metadata
    from armcell.scene import PlanningScene

    model = _two()
    scene = PlanningScene.of(model)
    about = run_metadata(_cell(), 3, "sim")
    with tempfile.TemporaryDirectory() as folder:
        recorder = RunRecorder(Path(folder) / "run", scene, start_ns=10**18, metadata=about)
        names = model.joint_names
        recorder.on_event(Event(0.0, "stage", "move", {"phase": "begin"}))
        recorder.on_trajectory(0.0, JointTrajectory(names, np.array([0.0, 1.0]), np.zeros((2, len(names)))))
        for i in range(5):
            q = np.full(len(names), 0.01 * i)
            recorder.on_state(StateSample(0.1 * i, JointState(names, q, q)))
        recorder.finish({"success": True, "stages": []})
        return recorder.mcap_file.read_bytes()


@cache
def _bag() -> bytes:
    from mcap.writer import CompressionType, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    T = store.types
    stamp = T["builtin_interfaces/msg/Time"](1, 0)
    header = T["std_msgs/msg/Header"](stamp, "camera")
    roi = T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    info = T["sensor_msgs/msg/CameraInfo"](
        header, 2, 4, "plumb_bob", np.zeros(5), np.array([4.0, 0, 2, 0, 4, 1, 0, 0, 1]), np.eye(3).ravel(),
        np.zeros(12), 0, 0, roi,
    )  # fmt: skip
    image = T["sensor_msgs/msg/Image"](header, 2, 4, "16UC1", 0, 8, np.full(16, 3, np.uint8))
    file = io.BytesIO()
    writer = Writer(file, compression=CompressionType.NONE)
    writer.start()
    for topic, kind, message in (("/info", "CameraInfo", info), ("/depth", "Image", image)):
        name = f"sensor_msgs/msg/{kind}"
        schema = writer.register_schema(name, "ros2msg", b"")
        channel = writer.register_channel(topic, "cdr", schema)
        writer.add_message(channel, 0, bytes(store.serialize_cdr(message, name)), 0)
    writer.finish()
    return file.getvalue()


def camera(path: Path) -> None:
    from armcell.perception.camera_files import load_image

    np.save(path.parent / "depth.npy", np.ones((6, 8), np.float32))
    load_image(path, depth=path.parent / "depth.npy")


def picture(path: Path) -> None:
    from armcell.core import ArmcellError
    from armcell.perception.camera_files import load_depth, load_rgb

    try:
        load_depth(path)
    except ArmcellError:
        load_rgb(path)


@cache
def _png() -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(np.arange(48, dtype=np.uint16).reshape(6, 8)).save(file, format="png")
    return file.getvalue()


def campaign(path: Path) -> None:
    from armcell.campaigns import CampaignSpec

    CampaignSpec.read(path)


def campaign_folder(path: Path) -> None:
    from armcell.campaigns.store import stored_spec

    stored_spec(path.parent)


def trials(path: Path) -> None:
    from armcell.campaigns.statistics import causes, effects, success
    from armcell.campaigns.store import rows_of

    rows, _ = rows_of(path)
    for told in (success, causes, effects):
        told(rows)


def gate_record(path: Path) -> None:
    from armcell.campaigns import gate

    gate.check(_cell(), path)


@cache
def _cell() -> Any:
    from armcell.cell import load

    return load(SEEDS / "cell.yaml")


def bands(path: Path) -> None:
    from armcell.twin.residual_thresholds import ResidualThresholds

    ResidualThresholds.load(path)


@cache
def _json(kind: str) -> bytes:
    from armcell.campaigns.gate import FORMAT as GATE_FORMAT
    from armcell.campaigns.spec import CampaignSpec
    from armcell.campaigns.store import FORMAT
    from armcell.campaigns.trial import Trial, failed
    from armcell.twin import residual_thresholds as twin

    if kind == "campaign":
        data: Any = {"format": FORMAT, "spec": CampaignSpec("cell.yaml").as_dict(), "hashes": {"cell": "0"}}
    elif kind == "gate":
        data = {"format": GATE_FORMAT, "hashes": {"cell": "0"}, "least": 0.95, "versions": {"armcell": "0"},
                "campaign": {"interval": [0.96, 1.0]}, "signature": "00"}  # fmt: skip
    elif kind == "bands":
        one, each = ("lag", "current_lag", "load", "trip"), (
            "position", "velocity", "gain", "friction", "viscous", "offset", "current", "spread",
        )  # fmt: skip
        arm = {**dict.fromkeys(one, 0.1), **{name: [0.1] * 6 for name in each}, "samples": 300}
        data = {"format": twin.FORMAT, "identity": {"arm": "0"}, "arms": {"arm": arm}}
    else:
        rows = (failed(Trial(i, i, {"a.b": 0.5}, (0.5,)), "FAILURE", "it failed") for i in range(3))
        return b"".join(json.dumps(row).encode() + b"\n" for row in rows)
    return json.dumps(data, indent=1).encode()


# --- wires ---
@cache
def _controller(frozen: bool = False) -> Any:
    """The servers of an emulated controller, on ports of their own, and a link to it."""
    import selectors

    from armcell.drivers.ur.wire.models import ur_model
    from armcell.emulators.network import Network, TcpConnection
    from armcell.emulators.ur.dashboard_server import DashboardServer, GripperServer
    from armcell.emulators.ur.plant import KinematicPlant
    from armcell.emulators.ur.robot import Robot
    from armcell.emulators.ur.rtde_server import RtdeServer
    from armcell.emulators.ur.script_server import ExternalControl, ScriptServer

    class Servers:
        def __init__(self) -> None:
            self.network = Network(selectors.DefaultSelector())
            self.robot = Robot(
                ur_model("UR10e"), KinematicPlant(np.array([0.0, -1.5, 1.5, -1.5, -1.5, 0])), "1"
            )
            external = ExternalControl(self.robot, self.network, None)
            self.rtde = RtdeServer(self.robot, self.network, "127.0.0.1", 0)
            self.dashboard = DashboardServer(self.robot, self.network, "127.0.0.1", external, 0)
            self.script = ScriptServer(self.robot, self.network, "127.0.0.1", (0, 0, 0))
            self.gripper = GripperServer(self.robot, self.network, "127.0.0.1", 0)

        def hear(self, server: Any, data: bytes, steps: int = 20) -> None:
            with socket.create_server(("127.0.0.1", 0)) as listening:
                ours = socket.create_connection(listening.getsockname())
                theirs, _ = listening.accept()
            link = TcpConnection(theirs, self.network)
            if hasattr(server, "_begin"):
                server._begin(link, 30001, False) if server is self.script else server._begin(link)
            link.received += data
            server._data(link)
            for _ in range(steps):
                self.step()
            link.close()
            ours.close()

        def step(self) -> None:
            self.robot.before_step()
            self.robot.plant.step(self.robot.period)
            self.robot.after_step()
            self.rtde.send_outputs()
            self.script.send_state()

    return Servers


def _served(name: str, steps: int = 20) -> Callable[[Path], None]:
    def take(path: Path) -> None:
        servers = _controller()()
        try:
            servers.hear(getattr(servers, name), path.read_bytes(), steps)
        finally:
            servers.network.close()

    return take


def urscript(path: Path) -> None:
    """Through the script port, as a driver's program comes."""
    from armcell.emulators.ur.script_server import run_script

    servers = _controller()()
    try:
        run_script(servers.robot, servers.network, path.read_text(errors="replace"))
        for _ in range(40):
            servers.step()
    finally:
        servers.network.close()


def rtde_client(path: Path) -> None:
    from armcell.drivers.ur.wire import rtde

    recipe = rtde.Recipe(["actual_q", "timestamp"], ["VECTOR6D", "DOUBLE"])
    for kind, payload in rtde.frames(bytearray(path.read_bytes())):
        if kind == rtde.DATA:
            recipe.unpack(payload[1:])
        rtde.split_names(payload)


def primary_client(path: Path) -> None:
    """As `identity.read_geometry` reads it, from a socket."""
    from armcell.drivers.ur import identity

    with socket.create_server(("127.0.0.1", 0)) as server:
        before, identity.PRIMARY_PORT = identity.PRIMARY_PORT, server.getsockname()[1]
        try:
            import threading

            def tell() -> None:
                link, _ = server.accept()
                with link:
                    link.sendall(path.read_bytes())

            threading.Thread(target=tell, daemon=True).start()
            identity.read_geometry("127.0.0.1", 0.5)
        finally:
            identity.PRIMARY_PORT = before


@cache
def _rtde(side: str) -> bytes:
    from armcell.drivers.ur.wire import rtde

    if side == "client":
        values = struct.pack(">B6dd", 1, *range(6), 1.0)
        return rtde.frame(rtde.VERSION, b"\x01") + rtde.frame(rtde.DATA, values)
    outputs = struct.pack(">d", 500.0) + b"timestamp,actual_q,robot_mode"
    inputs = b"input_int_register_20,input_double_register_20"
    return (
        rtde.frame(rtde.VERSION, struct.pack(">H", 2)) + rtde.frame(rtde.CONTROLLER_VERSION)
        + rtde.frame(rtde.SETUP_OUTPUTS, outputs) + rtde.frame(rtde.SETUP_INPUTS, inputs)
        + rtde.frame(rtde.START) + rtde.frame(rtde.DATA, struct.pack(">Bid", 1, 5, 0.5))
        + rtde.frame(rtde.PAUSE)
    )  # fmt: skip


@cache
def _primary() -> bytes:
    from armcell.drivers.ur.wire import primary, robot_messages
    from armcell.drivers.ur.wire.models import ur_model

    model = ur_model("UR10e")
    limits = [(-6.2, 6.2)] * 6
    configuration = primary.configuration_package(limits, [2.0] * 6, [5.0] * 6, model.dh, 2)
    mode = primary.mode_package(10**6, True, False, False, True, False, 7, 1.0, 1.0)
    kinematics = struct.pack(">6I", *range(6)) + struct.pack(">24d", *[0.1] * 24) + struct.pack(">I", 1)
    package = struct.pack(">iB", 5 + len(kinematics), primary.KINEMATICS) + kinematics
    return robot_messages.version(0, "URControl", (5, 9, 4), 0) + primary.robot_state(
        [mode, configuration, package]
    )


def definition(path: Path) -> None:
    from armcell.ros.definitions import parse

    parse(path.read_text(errors="replace"), "arms/Arm")


def fields(path: Path) -> None:
    """As `armcell topic pub` takes them."""
    from armcell.cli.topic import fill_message, yaml_values
    from armcell.ros import schema
    from armcell.ros.codec import ros1_codec

    message = schema().new("trajectory_msgs/JointTrajectory")
    text = path.read_text(errors="replace")
    ros1_codec().encode(fill_message(message, yaml_values(text)))


@cache
def targets() -> dict[str, Target]:
    """Every target by name. Seeds that have to be computed are computed here."""
    from armcell.ros.definitions import parse  # noqa: F401

    stl = _mesh_as("stl")
    found = [
        Target("urdf", "two.urdf", (seed("two.urdf"),), urdf),
        Target("xacro", "two.urdf.xacro", (seed("two.urdf.xacro"),), urdf),
        Target("srdf", "two.srdf", (seed("two.srdf"),), srdf),
        Target("joint_limits", "joint_limits.yaml", (seed("joint_limits.yaml"),), joint_limits),
        *(
            Target(f"package-{Path(name).stem}", f"config/{name}", (seed(name),), package)
            for name in CONFIG
            if name.endswith(".yaml") and name != "joint_limits.yaml"
        ),
        Target("robot", "robot.yaml", (seed("robot.yaml"),), robot),
        Target("cell", "cell.yaml", (seed("cell.yaml"),), cell),
        Target("objects", "objects.yaml", (seed("objects.yaml"),), objects),
        Target("sdf", "cell.world", (seed("cell.world"), seed("models/crate/model.sdf")), sdf),
        Target("sdf-included", "models/crate/model.sdf", (seed("models/crate/model.sdf"),), sdf_included),
        Target("sdf-config", "models/crate/model.config", (seed("models/crate/model.config"),), sdf_included),
        Target("gains", "gains.yaml", (seed("controllers.yaml"), seed("gains.yaml")), gains),
        *(
            Target(f"mesh-{kind}", f"part.{kind}", seeds, mesh)
            for kind, seeds in {
                "obj": (seed("part.obj"),), "off": (seed("part.off"),),
                "ply": (seed("part.ply"), _mesh_as("ply")),
                "stl": (seed("part.stl"), stl), "glb": (_mesh_as("glb"),), "dae": (_mesh_as("dae"),),
            }.items()
        ),
        *(
            Target(f"cloud-{kind}", f"cloud.{kind}", seeds, cloud)
            for kind, seeds in {
                "xyz": (seed("cloud.xyz"),), "pcd": (seed("cloud.pcd"), _cloud_as("pcd")),
                "ply": (seed("part.ply"),), "npy": (_cloud_as("npy"),), "npz": (_cloud_as("npz"),),
            }.items()
        ),
        Target("octomap-bt", "map.bt", (_octree(False),), octomap),
        Target("octomap-ot", "map.ot", (_octree(True),), octomap),
        Target("scene", "world.scene", (seed("world.scene"),), scene_file),
        Target("record", "run.mcap", (_record(),), record),
        Target("bag", "bag.mcap", (_bag(),), bag),
        Target("camera", "camera.yaml", (seed("camera.yaml"),), camera),
        Target("picture", "depth.png", (_png(), gzip.compress(b"")), picture),
        Target("campaign", "campaign.yaml", (seed("campaign.yaml"),), campaign),
        Target("campaign-folder", "campaign.json", (_json("campaign"),), campaign_folder),
        Target("trials", "trials.jsonl", (_json("trials"),), trials),
        Target("gate", "cell.gate.json", (_json("gate"),), gate_record),
        Target("bands", "cell.twin.json", (_json("bands"),), bands),
        Target("urscript", "program.script", (seed("program.script"), seed("short.script")), urscript),
        Target("script-port", "script.bin", (seed("short.script"),), _served("script")),
        Target("dashboard", "dashboard.txt", (seed("dashboard.txt"),), _served("dashboard")),
        Target("gripper", "gripper.txt", (seed("gripper.txt"),), _served("gripper")),
        Target("rtde-server", "rtde.bin", (_rtde("server"),), _served("rtde")),
        Target("rtde-client", "rtde.bin", (_rtde("client"),), rtde_client),
        Target("primary", "primary.bin", (_primary(),), primary_client),
        Target("definition", "Arm.msg", (seed("Arm.msg"),), definition),
        Target("fields", "fields.yaml", (seed("fields.yaml"),), fields),
    ]  # fmt: skip
    return {target.name: target for target in found}

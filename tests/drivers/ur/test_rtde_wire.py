"""RTDE as independent clients speak it: every published name and type, both protocol versions.

The expectation below is written from UR's "Real-Time Data Exchange (RTDE) Guide" (tables "Robot controller
inputs" and "Robot controller outputs", all versions) and the type list of UR's C++ client library, one line
per name in their order; it shares nothing with `armcell.drivers.ur.wire.rtde`.
"""

import selectors
import socket
import struct
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts

from armcell.drivers.ur.wire import rtde
from armcell.drivers.ur.wire.models import ur_model
from armcell.emulators.network import Network, TcpConnection
from armcell.emulators.ur.plant import KinematicPlant
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.rtde_server import RtdeServer

INPUTS = """
speed_slider_mask UINT32
speed_slider_fraction DOUBLE
standard_digital_output_mask UINT8
configurable_digital_output_mask UINT8
standard_digital_output UINT8
configurable_digital_output UINT8
standard_analog_output_mask UINT8
standard_analog_output_type UINT8
standard_analog_output_0 DOUBLE
standard_analog_output_1 DOUBLE
input_bit_registers0_to_31 UINT32
input_bit_registers32_to_63 UINT32
input_bit_register_[64..127] BOOL
input_int_register_[0..47] INT32
input_double_register_[0..47] DOUBLE
external_force_torque VECTOR6D
tool_digital_output_mask UINT8
tool_digital_output UINT8
"""

OUTPUTS = """
timestamp DOUBLE
target_q VECTOR6D
target_qd VECTOR6D
target_qdd VECTOR6D
target_current VECTOR6D
target_moment VECTOR6D
actual_q VECTOR6D
actual_qd VECTOR6D
actual_current VECTOR6D
actual_current_window VECTOR6D
actual_current_as_torque VECTOR6D
joint_control_output VECTOR6D
actual_TCP_pose VECTOR6D
actual_TCP_speed VECTOR6D
actual_TCP_force VECTOR6D
target_TCP_pose VECTOR6D
target_TCP_speed VECTOR6D
tcp_offset VECTOR6D
actual_TCP_acceleration VECTOR6D
target_TCP_acceleration VECTOR6D
actual_digital_input_bits UINT64
actual_configurable_digital_input_bits UINT64
joint_temperatures VECTOR6D
actual_execution_time DOUBLE
target_execution_time DOUBLE
robot_mode INT32
joint_mode VECTOR6INT32
safety_mode INT32
safety_status INT32
actual_tool_accelerometer VECTOR3D
speed_scaling DOUBLE
target_speed_fraction DOUBLE
actual_momentum DOUBLE
actual_main_voltage DOUBLE
actual_robot_voltage DOUBLE
actual_robot_current DOUBLE
actual_joint_voltage VECTOR6D
actual_digital_output_bits UINT64
actual_configurable_digital_output_bits UINT64
runtime_state UINT32
elbow_position VECTOR3D
elbow_velocity VECTOR3D
robot_status_bits UINT32
safety_status_bits UINT32
analog_io_types UINT32
standard_analog_input0 DOUBLE
standard_analog_input1 DOUBLE
standard_analog_output0 DOUBLE
standard_analog_output1 DOUBLE
io_current DOUBLE
euromap67_input_bits UINT32
euromap67_output_bits UINT32
euromap67_24V_voltage DOUBLE
euromap67_24V_current DOUBLE
tool_mode UINT32
tool_analog_input_types UINT32
tool_analog_input0 DOUBLE
tool_analog_input1 DOUBLE
tool_output_voltage INT32
tool_output_current DOUBLE
tool_temperature DOUBLE
tcp_force_scalar DOUBLE
output_bit_registers0_to_31 UINT32
output_bit_registers32_to_63 UINT32
output_bit_register_[64..127] BOOL
output_int_register_[0..47] INT32
output_double_register_[0..47] DOUBLE
input_bit_registers0_to_31 UINT32
input_bit_registers32_to_63 UINT32
input_bit_register_[64..127] BOOL
input_int_register_[0..47] INT32
input_double_register_[0..47] DOUBLE
tool_output_mode UINT8
tool_digital_output0_mode UINT8
tool_digital_output1_mode UINT8
payload DOUBLE
payload_cog VECTOR3D
payload_inertia VECTOR6D
script_control_line UINT32
ft_raw_wrench VECTOR6D
wrench_calc_from_currents VECTOR6D
joint_position_deviation_ratio DOUBLE
collision_detection_ratio DOUBLE
time_scale_source INT32
actual_robot_energy_consumed DOUBLE
actual_robot_braking_energy_dissipated DOUBLE
encoder0_raw INT32
encoder1_raw INT32
target_gravity VECTOR3D
target_base_acceleration VECTOR6D
control_step UINT64
target_base_wrench VECTOR6D
"""

SIZES = {
    "BOOL": 1, "UINT8": 1, "UINT32": 4, "INT32": 4, "UINT64": 8, "DOUBLE": 8, "VECTOR3D": 24,
    "VECTOR6D": 48, "VECTOR6INT32": 24, "VECTOR6UINT32": 24,
}  # fmt: skip


def expected(text: str) -> dict[str, str]:
    table = {}
    for line in text.split("\n"):
        if "[" in line:
            head, _, rest = line.partition("[")
            bounds, _, kind = rest.partition("]")
            low, high = bounds.split("..")
            table |= {f"{head}{i}": kind.strip() for i in range(int(low), int(high) + 1)}
        elif line:
            name, kind = line.split()
            table[name] = kind
    return table


class Client:
    """An RTDE client by the guide alone."""

    def __init__(self, host: str, version: int):
        self.socket = socket.create_connection((host, 30004), 5.0)
        self.socket.settimeout(5.0)
        assert self.ask("V", struct.pack(">H", version)) == b"\x01"

    def ask(self, kind: str, payload: bytes = b"") -> bytes:
        self.send(kind, payload)
        return self.next(kind)

    def send(self, kind: str, payload: bytes) -> None:
        self.socket.sendall(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)

    def next(self, kind: str) -> bytes:
        while True:
            size, found = struct.unpack(">HB", self._exactly(3))
            body = self._exactly(size - 3)
            if found == ord(kind):
                return body

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            more = self.socket.recv(count - len(data))
            assert more, "the controller closed the connection"
            data += more
        return data

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()


def parts(table: dict[str, str], limit: int = 2000) -> list[list[str]]:
    """Names in lists that fit a recipe's 2048 bytes."""
    lists, used = [[]], 0
    for name in table:
        if used + len(name) + 1 > limit:
            lists.append([])
            used = 0
        lists[-1].append(name)
        used += len(name) + 1
    return lists


@pytest.fixture(scope="module", params=["UR10", "UR10e"])
def host(request):
    (address,) = free_hosts(1)
    with emulator("--model", request.param, hosts=[address]):
        yield address


def test_the_tables_are_the_published_ones():
    assert expected(OUTPUTS) == rtde.OUTPUTS
    assert expected(INPUTS) == rtde.INPUTS


@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.parametrize("version", [1, 2])
def test_every_output_comes_with_its_type_and_size(host, version):
    table = expected(OUTPUTS)
    for names in parts(table):
        with Client(host, version) as client:
            head = struct.pack(">d", 125.0) if version == 2 else b""
            answer = client.ask("O", head + ",".join(names).encode())
            if version == 2:
                assert answer[0] == 1
                answer = answer[1:]
            assert answer.decode().split(",") == [table[name] for name in names]
            assert client.ask("S") == b"\x01"
            data = client.next("U")
            assert len(data) == sum(SIZES[table[name]] for name in names) + (version == 2)


@pytest.mark.realtime
@pytest.mark.slow
def test_every_input_is_accepted_with_its_type(host):
    table = expected(INPUTS)
    with Client(host, 2) as client:
        for number, names in enumerate(parts(table), start=1):
            answer = client.ask("I", ",".join(names).encode())
            assert answer[0] == number
            assert answer[1:].decode().split(",") == [table[name] for name in names]


def ask_outputs(client: Client, *names: str) -> None:
    table = expected(OUTPUTS)
    answer = client.ask("O", struct.pack(">d", 125.0) + ",".join(names).encode())
    assert answer[1:].decode().split(",") == [table[name] for name in names]


@pytest.mark.realtime
@pytest.mark.slow
def test_inputs_are_read_back_and_reach_the_outputs(host):
    with Client(host, 2) as client:
        names = (
            "input_bit_registers0_to_31,input_bit_register_70,input_int_register_5,input_double_register_40,"
            "standard_analog_output_mask,standard_analog_output_type,standard_analog_output_0,"
            "standard_analog_output_1"
        )
        assert client.ask("I", names.encode())[0] == 1
        ask_outputs(
            client, "input_bit_registers0_to_31", "input_bit_register_70", "input_int_register_5",
            "input_double_register_40", "standard_analog_output0", "standard_analog_output1",
            "analog_io_types",
        )  # fmt: skip
        assert client.ask("S") == b"\x01"
        client.send("U", struct.pack(">BI?idBBdd", 1, 0xA5, True, -7, 2.5, 3, 0b10, 0.25, 0.5))
        wanted = (0xA5, True, -7, 2.5, 8.0, 5.0, 0b1011)  # 4 + 16 * 0.25 mA; 10 * 0.5 V
        end, seen = time.monotonic() + 3.0, None
        while seen != wanted and time.monotonic() < end:
            seen = struct.unpack(">I?idddI", client.next("U")[1:])
        assert seen == wanted


@pytest.mark.realtime
@pytest.mark.slow
def test_an_external_sensor_gives_the_tcp_force(host):
    """The input is in flange axes, the output in base axes; it counts once a program has enabled it."""
    given = np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])

    def outputs(client) -> tuple[np.ndarray, np.ndarray]:
        pose_and_force = np.array(struct.unpack(">12d", client.next("U")[1:]))
        return pose_and_force[:6], pose_and_force[6:]

    def expect_force(client, within: float, *wanted: float) -> None:
        end = time.monotonic() + 5.0
        while True:
            pose, force = outputs(client)
            expect = Rotation.from_rotvec(pose[3:]).apply(np.reshape(wanted, (2, 3))).ravel()
            if np.abs(force - expect).max() < within or time.monotonic() > end:
                return np.testing.assert_allclose(force, expect, atol=within)

    with Client(host, 2) as client, socket.create_connection((host, 30002)) as scripts:
        assert client.ask("I", b"external_force_torque") == b"\x01VECTOR6D"
        ask_outputs(client, "actual_TCP_pose", "actual_TCP_force")
        assert client.ask("S") == b"\x01"
        client.send("U", struct.pack(">B6d", 1, *given))
        before = outputs(client)[1]
        for function in ("ft_rtde_input_enable", "enable_external_ft_sensor"):
            scripts.sendall(f"sec on():\n  {function}(True)\nend\n".encode())
            expect_force(client, 1e-9, *given)
            scripts.sendall(f"sec off():\n  {function}(False)\nend\n".encode())
            end = time.monotonic() + 5.0
            while np.abs((now := outputs(client)[1]) - before).max() > 0.1 and time.monotonic() < end:
                pass
            np.testing.assert_allclose(now, before, atol=0.1)  # the arm's own sensor, with its offset


@pytest.mark.slow
@pytest.mark.cases("UR10")
def test_values_agree_with_each_other_while_the_arm_moves(host):
    names = (
        "timestamp", "control_step", "actual_q", "actual_qd", "target_qdd", "elbow_position",
        "elbow_velocity", "actual_TCP_pose", "actual_TCP_speed", "actual_TCP_acceleration", "tool_mode",
        "script_control_line",
    )  # fmt: skip
    with Client(host, 2) as client, socket.create_connection((host, 30003), 5.0) as script:
        ask_outputs(client, *names)
        assert client.ask("S") == b"\x01"
        script.sendall(
            b"def sweep():\n  q = get_actual_joint_positions()\n  q[0] = q[0] + 0.6\n"
            b"  movej(q, a=2.0, v=0.8)\nend\n"
        )
        rows = []
        began = time.monotonic()
        while time.monotonic() < began + 2.5:
            rows.append(struct.unpack(">dQ6d6d6d3d3d6d6d6dII", client.next("U")[1:]))
    values = np.array(rows)
    t, step, q, v = values[:, 0], values[:, 1], values[:, 2:8], values[:, 8:14]
    elbow, elbow_v = values[:, 20:23], values[:, 23:26]
    pose, speed, acceleration = values[:, 26:32], values[:, 32:38], values[:, 38:44]
    assert np.all(values[:, 44] == 253)
    lines = set(values[:, 45])
    assert lines == {0.0, 4.0}, "the movej is in the script's fourth line"
    periods = np.diff(t) / np.diff(step)
    assert periods.min() == pytest.approx(periods.max()) and round(1.0 / periods[0]) in (125, 500)
    assert np.ptp(q[:, 0]) == pytest.approx(0.6, abs=0.01)
    dt = np.diff(t)
    middle = slice(5, -5)
    for value, rate, tolerance in ((q, v, 0.02), (elbow, elbow_v, 0.02), (pose[:, :3], speed[:, :3], 0.02)):
        slope = np.diff(value, axis=0) / dt[:, None]
        np.testing.assert_allclose(slope[middle], 0.5 * (rate[1:] + rate[:-1])[middle], atol=tolerance)
    reached = np.cumsum(acceleration[1:, :3] * dt[:, None], axis=0)
    np.testing.assert_allclose(reached, speed[1:, :3] - speed[0, :3], atol=0.08)


@pytest.mark.realtime
@pytest.mark.slow
def test_a_name_no_controller_has_spoils_its_recipe_alone(host):
    with Client(host, 2) as client:
        answer = client.ask("O", struct.pack(">d", 125.0) + b"actual_q,joint_mood")
        assert answer[1:] == b"VECTOR6D,NOT_FOUND"
        assert client.ask("S") == b"\x00"
        ask_outputs(client, "actual_q")
        assert client.ask("S") == b"\x01"


@pytest.mark.realtime
@pytest.mark.slow
def test_a_text_message_is_logged_and_the_link_goes_on(host):
    with Client(host, 2) as client:
        client.send("M", b"\x05hello\x04test\x03")
        ask_outputs(client, "timestamp")
        assert client.ask("S") == b"\x01"
        assert len(client.next("U")) == 9
    assert "RTDE client: test: hello" in dashboard(host, "armcell messages")[0]


def test_a_client_that_asks_for_hardly_any_packets_is_served():
    network = Network(selectors.DefaultSelector())
    robot = Robot(ur_model("UR10e"), KinematicPlant([0.0, -1.5, 1.5, -1.5, -1.5, 0.0]), "1")
    server = RtdeServer(robot, network, "127.0.0.1", 0)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        ours = socket.create_connection(listening.getsockname())
        link = TcpConnection(listening.accept()[0], network)
    server._begin(link)
    link.received += rtde.frame(rtde.VERSION, struct.pack(">H", 2))
    link.received += rtde.frame(rtde.SETUP_OUTPUTS, struct.pack(">d", 5e-324) + b"timestamp")
    link.received += rtde.frame(rtde.START)
    server._data(link)
    server.send_outputs()
    assert link.open
    answers = list(rtde.frames(bytearray(ours.recv(1000))))
    assert answers[1:] == [(rtde.SETUP_OUTPUTS, b"\x01DOUBLE"), (rtde.START, b"\x01")]
    link.close()
    ours.close()

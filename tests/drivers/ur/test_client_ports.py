"""Primary, secondary and real-time ports by UR's "Client Interface" documents, with a parser of its own."""

import socket
import struct
import time

import numpy as np
import pytest
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

# Sizes of the packages of a robot state message, header of 5 bytes included (3.15 and 5.11).
SIZES = {0: 47, 1: 251, 2: 37, 3: 75, 4: 101, 5: 225, 6: 445, 7: 61, 8: 9, 9: 53, 10: 43}
E_SERIES = {11: 26, 12: 8}
TEXT, POPUP, VERSION, SAFETY, ERROR, KEY, EXCEPTION = 0, 2, 3, 5, 6, 7, 10


class Port:
    """A client of one port: messages as (type, body)."""

    def __init__(self, host: str, port: int):
        self.socket = socket.create_connection((host, port), 5.0)
        self.socket.settimeout(0.1)
        self.buffer = b""

    def send(self, text: str) -> None:
        self.socket.sendall(text.encode())

    def messages(self, seconds: float) -> list[tuple[int, bytes]]:
        """Messages that come within a time [s]."""
        found, end = [], time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                self.buffer += self.socket.recv(65536)
            except TimeoutError:
                continue
            while len(self.buffer) >= 5:
                size, kind = struct.unpack_from(">iB", self.buffer)
                if len(self.buffer) < size:
                    break
                found.append((kind, self.buffer[5:size]))
                self.buffer = self.buffer[size:]
        return found

    def robot_messages(self, seconds: float) -> list[tuple[int, bytes]]:
        """Robot messages (sub-type, fields) that come within a time [s]."""
        return [(body[9], body[10:]) for kind, body in self.messages(seconds) if kind == 20]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()


def packages(body: bytes) -> dict[int, bytes]:
    found, at = {}, 0
    while at < len(body):
        size, kind = struct.unpack_from(">iB", body, at)
        found[kind] = body[at + 5 : at + size]
        at += size
    assert at == len(body)
    return found


@pytest.fixture(scope="module", params=["UR10", "UR10e"])
def arm(request):
    (host,) = free_hosts(1)
    with emulator("--model", request.param, hosts=[host]):
        yield host, request.param


@pytest.mark.parametrize("port", [30001, 30002, 30011, 30012])
def test_a_client_first_gets_the_version_then_the_state_ten_times_a_second(arm, port):
    host, model = arm
    with Port(host, port) as client:
        found = client.messages(2.0)
    kind, body = found[0]
    assert kind == 20 and body[9] == VERSION and body[10] == 9 and body[11:20] == b"URControl"
    assert body[20] == (5 if model == "UR10e" else 3)
    states = [body for kind, body in found if kind == 16]
    assert 17 <= len(states) <= 22 and len(states) == len(found) - 1
    sizes = {kind: len(body) + 5 for kind, body in packages(states[-1]).items()}
    assert sizes == SIZES | (E_SERIES if model == "UR10e" else {})


def test_the_packages_say_the_same_as_the_dashboard_and_each_other(arm):
    host, _ = arm
    dashboard(host, "armcell push 1 2 3")
    with Port(host, 30002) as client:
        client.send("def f():\n  set_tcp(p[0,0,0.1,0,0,0])\n  set_configurable_digital_out(1, True)\nend\n")
        time.sleep(0.4)
        found = packages([body for kind, body in client.messages(0.5) if kind == 16][-1])
        client.send("set_tcp(p[0,0,0,0,0,0])\n")
        time.sleep(0.2)
    dashboard(host, "armcell push 0 0 0")
    assert (
        found[0][8:15] == bytes([1, 1, 1, 0, 0, 0, 0]) and found[0][15] == 7
    )  # running, no stop, no program
    joints = [struct.unpack_from(">dddffffB", found[1], 41 * i) for i in range(6)]
    for actual, target, speed, _, voltage, heat, _, mode in joints:
        assert actual == pytest.approx(target, abs=1e-3) and speed == pytest.approx(0.0, abs=1e-3)
        assert (voltage, heat, mode) == (48.0, 25.0, 253)
    pose = struct.unpack(">12d", found[4])
    assert pose[6:] == (0, 0, 0.1, 0, 0, 0)
    dh = np.array(struct.unpack(">24d", found[6][232 : 232 + 192])).reshape(4, 6)
    kinematics = np.array(struct.unpack(">24d", found[5][24:216])).reshape(4, 6)
    np.testing.assert_allclose(dh, kinematics[[1, 2, 3, 0]])  # a, d, alpha, theta; and theta, a, d, alpha
    assert struct.unpack(">6I", found[5][:24]) != (0,) * 6
    T = np.eye(4)
    for (actual, *_), theta, a, d, alpha in zip(joints, *kinematics, strict=True):
        c, s, ca, sa = np.cos(theta + actual), np.sin(theta + actual), np.cos(alpha), np.sin(alpha)
        T = T @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
    np.testing.assert_allclose(T @ [0, 0, 0.1, 1], [*pose[:3], 1], atol=1e-6)
    assert struct.unpack_from(">ii", found[3])[1] == 1 << 9 and found[3][60] == 1  # pin 9; safety mode normal
    assert struct.unpack_from(">3d", found[7]) == (1.0, 2.0, 3.0)


def test_the_realtime_port_sends_every_control_step(arm):
    host, model = arm
    period = 0.002 if model == "UR10e" else 0.008
    with socket.create_connection((host, 30003), 5.0) as link:
        data = b""
        end = time.monotonic() + 1.5
        while time.monotonic() < end:
            data += link.recv(65536)
    size = struct.unpack_from(">i", data)[0]
    assert size == 1220
    rows = np.array([struct.unpack_from(">152d", data, at + 4) for at in range(0, len(data) - size, size)])
    np.testing.assert_allclose(np.diff(rows[:, 0]), period, atol=1e-9)
    assert len(rows) > 0.5 / period
    assert np.all(rows[:, 94] == 7) and np.all(rows[:, 101] == 1) and np.all(rows[:, 95:101] == 253)


def test_a_client_that_never_reads_keeps_its_connection(arm):
    """As ur_rtde's script client: it writes to the real-time port hours after it connected."""
    host, _ = arm
    with socket.socket() as link:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        link.connect((host, 30003))
        time.sleep(6.0)  # more than a megabyte of an e-Series' states
        link.sendall(b"set_digital_out(4, True)\n")
        time.sleep(0.3)
    with Port(host, 30002) as client:
        state = [body for kind, body in client.messages(0.3) if kind == 16][-1]
    assert struct.unpack_from(">ii", packages(state)[3])[1] & 1 << 4


@pytest.mark.parametrize(("software", "size"), [("3.4", 1060), ("3.9", 1108), ("3.10", 1116), ("3.14", 1140)])
def test_older_software_sends_shorter_messages(software, size):
    (host,) = free_hosts(1)
    with emulator("--model", "UR10", "--software", software, hosts=[host]):
        with socket.create_connection((host, 30003), 5.0) as link:
            assert struct.unpack(">i", link.recv(4))[0] == size
        with Port(host, 30001) as client:
            (_, version), (_, state), *_ = client.messages(0.3)
        assert list(version[20:22]) == [int(x) for x in software.split(".")]
        assert len(packages(state)[0]) + 5 == (46 if software == "3.4" else 47)


def test_an_unknown_function_is_reported_where_it_stands(arm):
    host, _ = arm
    with Port(host, 30001) as client:
        client.robot_messages(0.2)
        client.send('def task():\n  textmsg("a")\n  open_door(1)\nend\n')
        found = client.robot_messages(0.6)
        assert [kind for kind, _ in found] == [EXCEPTION]  # and nothing ran
        line, column = struct.unpack_from(">ii", found[0][1])
        assert (line, column) == (3, 3) and found[0][1][8:] == b"compile_error_name_not_found:open_door:"
        client.send("def task():\n  x = 1 +\nend\n")
        ((kind, fields),) = client.robot_messages(0.6)
        assert kind == EXCEPTION and fields[8:].startswith(b"syntax_error_on_line:")
    assert "function 'open_door' is not known" in dashboard(host, "armcell messages")[0]


def test_a_program_s_course_is_reported(arm):
    host, _ = arm
    with Port(host, 30001) as client:
        client.robot_messages(0.2)
        client.send(
            'def task():\n  textmsg("value ", 2.5)\n  popup("look", title="Here")\n'
            "  x = [1]\n  y = x[3]\nend\n"
        )
        found = client.robot_messages(0.8)
    kinds = [kind for kind, _ in found]
    assert kinds == [KEY, TEXT, POPUP, EXCEPTION, KEY]
    assert found[0][1] == struct.pack(">iiB", 0, 0, 19) + b"PROGRAM_XXX_STARTEDtask"
    assert found[1][1] == b"value 2.5"
    assert found[2][1][8:] == b"\x04Herelook"
    assert struct.unpack_from(">i", found[3][1])[0] == 5 and b"index" in found[3][1]
    assert found[4][1] == struct.pack(">iiB", 0, 0, 19) + b"PROGRAM_XXX_STOPPEDtask"


def test_safety_modes_are_reported(arm):
    host, _ = arm
    with Port(host, 30001) as client:
        client.robot_messages(0.2)
        dashboard(host, "armcell protective stop", "unlock protective stop")
        found = [fields[8] for kind, fields in client.robot_messages(0.6) if kind == SAFETY]
    assert found == [3, 1]


def test_read_only_ports_take_no_program(arm):
    host, _ = arm
    with Port(host, 30011) as client:
        client.robot_messages(0.2)
        client.send("set_digital_out(5, True)\n")
        found = dict(client.robot_messages(0.6))
    assert struct.unpack_from(">iii", found[ERROR]) == (210, 0, 2) and KEY not in found


def test_a_secondary_program_does_not_end_the_main_one(arm):
    host, _ = arm
    with Port(host, 30001) as client:
        client.robot_messages(0.2)
        client.send("def main():\n  while True:\n    sync()\n  end\nend\n")
        client.send('sec aside():\n  set_digital_out(6, True)\n  textmsg("done")\nend\n')
        found = client.robot_messages(0.6)
        assert [kind for kind, _ in found] == [KEY, TEXT]
        assert dashboard(host, "running") == ["Program running: true"]
        client.send("stop program\n")
        ((kind, fields),) = client.robot_messages(0.6)
        assert kind == KEY and b"STOPPEDmain" in fields
        assert dashboard(host, "running") == ["Program running: false"]


def test_the_terminal_shows_why_a_program_ended():
    (host,) = free_hosts(1)
    with emulator(hosts=[host]) as process:
        with Port(host, 30002) as client:
            client.send("def task():\n  open_door()\nend\n")
            client.messages(0.5)
        process.terminate()
        out = process.communicate(timeout=20)[0]
    assert f"{host}: script error: line 2: function 'open_door' is not known to this controller" in out

"""`armcell tf` at each wire of a served cell: the whole tree, no fault; and one frame that is missing."""

import uuid

import pytest
from tests.cli.helpers import call

from armcell.cell import load
from armcell.ros import Bus, Ros1Graph, Ros1Settings, Ros2Bridge, Ros2Settings
from armcell.ros.nodes import ServedCell
from armcell.ros.ros2 import from_environment
from armcell.ros.tcp import RosTcpServer, ServerSettings


@pytest.fixture(scope="module")
def bus():
    found = Bus()
    with ServedCell(load("panda_pick").connect("fake", None, time_scale=1.0), found):
        yield found


@pytest.fixture
def tcp(bus):
    with RosTcpServer(bus, ServerSettings(port=0)) as server:
        yield "--connect", f"127.0.0.1:{server.address[1]}"


@pytest.fixture
def ros1(bus, monkeypatch):
    settings = Ros1Settings("cell", master="http://127.0.0.1:0", own_master=True)
    with Ros1Graph(bus, settings, bus_is_graph=True) as graph:
        assert graph.master is not None
        monkeypatch.setenv("ROS_MASTER_URI", graph.master.uri)
        yield ("--ros1",)


@pytest.fixture
def ros2(bus, monkeypatch):
    tag = f"<CycloneDDS><Domain><Discovery><Tag>{uuid.uuid4().hex}</Tag></Discovery></Domain></CycloneDDS>"
    monkeypatch.setenv("CYCLONEDDS_URI", tag)
    with Ros2Bridge(bus, Ros2Settings(from_environment(207))):
        yield "--ros2", "--domain", "207"


@pytest.mark.slow
@pytest.mark.cases("tcp")
@pytest.mark.parametrize("wire", ["tcp", "ros1", "ros2"])
def test_the_tree_of_a_served_cell(request, capsys, wire):
    where = request.getfixturevalue(wire)
    said = call(capsys, "tf", "panda_pick", *where)
    assert (said.status, said.err) == (0, ""), said
    lines = said.out.splitlines()
    assert lines[0] == "world" and any(line.strip().startswith("panda_hand ") for line in lines)
    missing = call(capsys, "tf", "six_axis_pick", *where, "--for", "1")
    assert missing.status == 1 and "frames" in missing.err and "are missing" in missing.err

"""Our node and our master among Debian's own: rospy, rosmaster, and the command line's tools."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest
import yaml
from tests.ros.ros1.conftest import eventually
from tests.ros.ros1.debian import debian

from armcell.core import InputError
from armcell.ros import Bus, ServiceError, schema
from armcell.ros.ros1 import Ros1Graph, Ros1Settings

pytestmark = pytest.mark.interop
__all__ = ["debian"]
S = schema()
STRING = "std_msgs/String"
RELAY = "/usr/lib/topic_tools/relay"

TALK = """
import json, rospy, sys
from std_msgs.msg import String
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, SetBoolResponse, Trigger
rospy.init_node("talker", anonymous=True)
found = {"latched": rospy.wait_for_message("/latched", String, timeout=10).data}
state = rospy.wait_for_message("/joint_states", JointState, timeout=10)
found["state"] = [list(state.name), list(state.position), state.header.frame_id, state.header.stamp.to_sec()]
rospy.wait_for_service("/ours", timeout=10)
found["call"] = rospy.ServiceProxy("/ours", SetBool)(True).message
keep = rospy.ServiceProxy("/ours", SetBool, persistent=True)
found["persistent"] = [keep(True).message for _ in range(5)]
try:
    rospy.ServiceProxy("/ours", SetBool)(False)
except rospy.ServiceException as error:
    found["refused"] = str(error)
try:
    rospy.ServiceProxy("/ours", Trigger)()
except rospy.ServiceException as error:
    found["wrong type"] = str(error)
rospy.Service("/theirs", SetBool, lambda r: SetBoolResponse(r.data, "from rospy"))
keep_latched = rospy.Publisher("/from_rospy", String, queue_size=5, latch=True)
keep_latched.publish("hello")
out = rospy.Publisher("/stream", String, queue_size=100)
while not out.get_num_connections():
    rospy.sleep(0.02)
for n in range(200):
    out.publish(str(n))
    rospy.sleep(0.002)
rospy.set_param("/from_rospy/list", [1, 2.5, "drei", {"a": True}])
found["param"] = rospy.get_param("/from_armcell")
found["missing"] = rospy.get_param("/none", "default")
done = rospy.wait_for_message("/done", String, timeout=20)
print(json.dumps(found))
"""


@pytest.fixture(params=["rosmaster", "our master"])
def joined(request, debian):
    """A bus in a graph whose master is the real one or our own."""
    if request.param == "rosmaster":
        debian.start_master()
    graph = Ros1Graph(
        Bus(), Ros1Settings(name="armcell", master=debian.uri, own_master=request.param == "our master")
    )
    with graph:
        yield graph


def test_rospy_talks_with_us(debian, joined):
    bus = joined.bus

    def answer(request):
        if not request.data:
            raise InputError("not that way", hint="say true")
        return S.new("std_srvs/SetBoolResponse", True, "from armcell")

    bus.advertise("/latched", STRING, latch=True).publish(S.new(STRING, "kept"))
    bus.advertise("/joint_states", "sensor_msgs/JointState", latch=True).publish(
        S.new("sensor_msgs/JointState", bus.header("base"), ["a", "b"], [0.5, -1.5])
    )
    bus.serve("/ours", "std_srvs/SetBool", answer)
    bus.parameters.set("/from_armcell", {"x": [1, 2]})
    stream = bus.subscribe("/stream", STRING, queue_size=1000)
    hello = bus.subscribe("/from_rospy", STRING)
    talker = debian.start_rospy(TALK)
    try:
        assert hello.get(20).data == "hello"
        assert [stream.get(10).data for _ in range(200)] == [str(n) for n in range(200)]
        assert bus.wait_for_service("/theirs", 10)
        assert bus.call("/theirs", S.new("std_srvs/SetBoolRequest", True)).message == "from rospy"
        with pytest.raises(ServiceError, match="md5sums do not match"):
            bus.call("/theirs", S.new("std_srvs/TriggerRequest"))
        late = bus.subscribe("/from_rospy", STRING)  # latched there, kept here
        assert late.get(5).data == "hello"
        eventually(lambda: bus.parameters.get("/from_rospy/list", None))
        assert bus.parameters.get("/from_rospy/list") == [1, 2.5, "drei", {"a": True}]
        with bus.advertise("/done", STRING, latch=True) as done:
            done.publish(S.new(STRING))
            assert talker.wait(20) == 0, debian.log(talker)
    finally:
        debian.stop(talker)
    found = json.loads(debian.log(talker).strip().splitlines()[-1])
    assert found["latched"] == "kept"
    assert found["state"][:3] == [["a", "b"], [0.5, -1.5], "base"]
    assert abs(found["state"][3] - time.time()) < 60
    assert found["call"] == "from armcell" and found["persistent"] == ["from armcell"] * 5
    assert "not that way" in found["refused"] and "md5sums do not match" in found["wrong type"]
    assert found["param"] == {"x": [1, 2]} and found["missing"] == "default"


def test_the_tools_see_us(debian, joined):
    bus = joined.bus
    bus.advertise("/hello", STRING, latch=True).publish(S.new(STRING, "world"))
    bus.serve("/ours", "std_srvs/Trigger", lambda _: S.new("std_srvs/TriggerResponse", True, "done"))
    heard = bus.subscribe("/words", STRING)
    assert joined.bridge.wait_settled(5)
    assert {"/hello", "/rosout", "/words"} <= set(debian.run("rostopic", "list").split())
    assert debian.run("rostopic", "type", "/hello").strip() == STRING
    assert "/armcell" in debian.run("rostopic", "info", "/hello")
    assert (
        yaml.safe_load(debian.run("rostopic", "echo", "-n1", "-p", "/hello").splitlines()[1].split(",")[1])
        == "world"
    )
    debian.run("rostopic", "pub", "-1", "/words", STRING, "{data: spoken}")
    assert heard.get(10).data == "spoken"
    assert {"/ours", "/armcell/get_loggers"} <= set(debian.run("rosservice", "list").split())
    assert debian.run("rosservice", "type", "/ours").strip() == "std_srvs/Trigger"
    assert yaml.safe_load(debian.run("rosservice", "call", "/ours")) == {"success": True, "message": "done"}
    assert 'name: "armcell"' in debian.run("rosservice", "call", "/armcell/get_loggers")
    debian.run("rosparam", "set", "/speed", "[1, 2.5, {a: true}]")
    assert bus.parameters.get("/speed") == [1, 2.5, {"a": True}]
    bus.parameters.set("/arm/name", "panda")
    assert yaml.safe_load(debian.run("rosparam", "get", "/arm")) == {"name": "panda"}
    assert "/arm/name" in debian.run("rosparam", "list").split()
    debian.run("rosparam", "delete", "/arm")
    assert "/arm/name" not in bus.parameters
    assert "/armcell" in debian.run("rosnode", "list").split()
    assert "xmlrpc reply from" in debian.run("rosnode", "ping", "-c", "1", "/armcell")
    info = debian.run("rosnode", "info", "/armcell")
    assert "/hello [std_msgs/String]" in info and "Pid: " in info and "/ours" in info
    debian.run("rosnode", "kill", "/armcell")
    assert joined.ended.wait(5) and "shut down by" in joined.reason


def test_other_types_are_refused_both_ways(debian, joined, caplog):
    bus = joined.bus
    bus.advertise("/ours", STRING, latch=True).publish(S.new(STRING, "x"))
    inbox = bus.subscribe("/theirs", STRING)
    found = debian.rospy(
        "import rospy, json\n"
        "from std_msgs.msg import Int32\n"
        "rospy.init_node('wrong')\n"
        "out = rospy.Publisher('/theirs', Int32, queue_size=5, latch=True)\n"
        "out.publish(3)\n"
        "try:\n"
        "    rospy.wait_for_message('/ours', Int32, timeout=2); said = 'came'\n"
        "except rospy.ROSException:\n"
        "    said = 'nothing'\n"
        "print(json.dumps(said))\n"
    )
    assert found == "nothing"
    assert inbox.get(0.2) is None
    text = " ".join(r.getMessage() for r in caplog.records)
    assert "topic types do not match: [std_msgs/Int32] vs. [std_msgs/String]" in text
    assert "it refuses" in text


def test_of_two_nodes_of_one_name_the_older_ends(debian, joined):
    script = "import rospy\nrospy.init_node('armcell')\nrospy.spin()\n"
    newer = debian.start_rospy(script)
    try:
        assert joined.ended.wait(20)
        assert "new node registered with same name" in joined.reason or "another node has" in joined.reason
        assert newer.poll() is None
        with Ros1Graph(Bus(), Ros1Settings(name="armcell", master=debian.uri, own_master=False)):
            assert newer.wait(20) is not None  # now that one is the older
    finally:
        debian.stop(newer)


def test_the_real_master_vanishes_and_returns(debian):
    master = debian.start_master()
    bus = Bus()
    bus.parameters.set("/robot_description", "<robot/>")
    out = bus.advertise("/beat", STRING)
    script = (
        "import rospy, json\nfrom std_msgs.msg import String\nrospy.init_node('listener', anonymous=True)\n"
        "print(json.dumps([rospy.wait_for_message('/beat', String, timeout=15).data,"
        " rospy.get_param('/robot_description')]))\n"
    )
    with Ros1Graph(bus, Ros1Settings(master=debian.uri, own_master=False)) as graph:
        graph.bus.subscribe("/words", STRING)
        debian.stop(master)
        eventually(lambda: not graph.node.registrar.reachable, 10)
        assert bus.parameters.get("/robot_description") == "<robot/>"  # what was kept
        debian.start_master()
        eventually(lambda: graph.node.registrar.reachable, 15)
        listener = debian.start_rospy(script)
        end = time.monotonic() + 20
        while listener.poll() is None and time.monotonic() < end:
            out.publish(S.new(STRING, "alive"))
            time.sleep(0.05)
        assert json.loads(debian.log(listener).splitlines()[-1]) == ["alive", "<robot/>"], debian.log(
            listener
        )


def test_a_publisher_vanishes_and_returns(debian, joined):
    inbox = joined.bus.subscribe("/beat", STRING, queue_size=1)
    script = (
        "import rospy, sys\nfrom std_msgs.msg import String\nrospy.init_node('beater')\n"
        "out = rospy.Publisher('/beat', String, queue_size=1)\nrate = rospy.Rate(50)\n"
        "while not rospy.is_shutdown():\n    out.publish(sys.argv[1]); rate.sleep()\n"
    )
    for word in ("first", "second"):
        beater = debian.start_rospy(script, word)
        eventually(lambda word=word: getattr(inbox.get(0.5), "data", "") == word, 15)
        beater.kill()  # without a word to the master
        beater.wait(5)


def test_rostopic_hz_sees_30_hz(debian, joined):
    out = joined.bus.advertise("/joint_states", "sensor_msgs/JointState")
    message = S.new("sensor_msgs/JointState", name=["a"], position=[1.0])
    process = debian.start("/usr/bin/rostopic", "hz", "/joint_states")
    began, n = time.monotonic(), 0
    while time.monotonic() - began < 12:
        out.publish(message)
        n += 1
        time.sleep(max(began + n / 30 - time.monotonic(), 0))
    process.send_signal(2)
    process.wait(10)
    rates = [float(r.split(":")[1]) for r in debian.log(process).splitlines() if r.startswith("average")]
    assert len(rates) >= 5 and abs(rates[-1] - 30.0) <= 0.5, rates


def test_every_type_that_debian_has_has_its_md5_sum(debian):
    parts = {f"{s}{part}" for s in S.services for part in ("Request", "Response")}
    names = [n for n in S.messages if n not in parts]
    for kind, wanted in (("messages", names), ("services", S.services)):
        (debian.folder / f"{kind}.json").write_text(json.dumps(wanted))
    found = debian.rospy(
        "import json, roslib.message\n"
        "found = {}\n"
        "for kind, get in (('messages', roslib.message.get_message_class),"
        " ('services', roslib.message.get_service_class)):\n"
        "    for name in json.load(open(kind + '.json')):\n"
        "        try:\n"
        "            cls = get(name)\n"
        "        except Exception:\n"
        "            cls = None\n"
        "        if cls: found[name] = cls._md5sum\n"
        "print(json.dumps(found))\n"
    )
    assert len(found) > 100
    assert {n: S.md5(n) for n in found} == found
    assert debian.run("rosmsg", "md5", "sensor_msgs/JointState").strip() == S.md5("sensor_msgs/JointState")
    assert debian.run("rossrv", "md5", "std_srvs/SetBool").strip() == S.md5("std_srvs/SetBool")


def test_tf2_finds_our_transforms(debian, joined):
    bus = joined.bus
    new = S.new

    def transform(parent, child, x, stamp):
        header = new("std_msgs/Header", 0, stamp, parent)
        moved = new(
            "geometry_msgs/Transform",
            new("geometry_msgs/Vector3", x, 0.0, 0.0),
            new("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 1.0),
        )
        return new("geometry_msgs/TransformStamped", header, child, moved)

    bus.advertise("/tf_static", "tf2_msgs/TFMessage", latch=True).publish(
        new("tf2_msgs/TFMessage", [transform("world", "base", 1.0, bus.stamp())])
    )
    out = bus.advertise("/tf", "tf2_msgs/TFMessage")
    looker = debian.start_rospy(
        "import rospy, tf2_ros\nrospy.init_node('looker')\nbuffer = tf2_ros.Buffer()\n"
        "listener = tf2_ros.TransformListener(buffer)\n"
        "t = buffer.lookup_transform('world', 'hand', rospy.Time(0), rospy.Duration(15))\n"
        "print(t.transform.translation.x)\n"
    )
    end = time.monotonic() + 20
    while looker.poll() is None and time.monotonic() < end:
        out.publish(new("tf2_msgs/TFMessage", [transform("base", "hand", 0.25, bus.stamp())]))
        time.sleep(0.03)
    assert debian.log(looker).strip().endswith("1.25"), debian.log(looker)


def test_nodes_in_cpp_talk_with_us(debian, joined):
    """roscpp: rosout takes our logs and serves; topic_tools' relay takes any type."""
    for program in ("/usr/lib/rosout/rosout", RELAY):
        if not Path(program).exists():
            pytest.skip(f"{program} is not installed (apt-get install rosout topic-tools)")
    bus = joined.bus
    debian.start("/usr/lib/rosout/rosout")
    relay = debian.start(RELAY, "/states", "/again")
    inbox = bus.subscribe("/again", "sensor_msgs/JointState", queue_size=1000)
    everybody = bus.subscribe("/rosout_agg", "rosgraph_msgs/Log", queue_size=100)
    out = bus.advertise("/states", "sensor_msgs/JointState")
    eventually(lambda: out.subscribers, 15)
    end = time.monotonic() + 15
    while inbox.get(0.05) is None and time.monotonic() < end:  # until the relay has advertised in turn
        out.publish(S.new("sensor_msgs/JointState", name=["first"]))
    while inbox.get(0.5) is not None:
        pass
    for n in range(100):
        out.publish(S.new("sensor_msgs/JointState", name=[str(n)], position=[float(n)]))
        time.sleep(0.002)
    assert [inbox.get(5).position[0] for _ in range(100)] == [float(n) for n in range(100)]
    heard = []

    def told():
        joined.say("warn", "from armcell to rosout")
        heard.extend(m for m in iter(lambda: everybody.get(0.2), None) if m.msg == "from armcell to rosout")
        return heard

    assert eventually(told, 15)[0].name == "/armcell"
    # Last, for Debian's roscpp 1.15.15 crashes after it has answered, its own rosservice as well.
    assert bus.wait_for_service("/rosout/get_loggers", 15)
    loggers = bus.call("/rosout/get_loggers", S.new("roscpp/GetLoggersRequest")).loggers
    assert any(x.name.startswith("ros.") for x in loggers)
    debian.stop(relay)
    eventually(lambda: out.subscribers == 0)

"""A plain DDS program that behaves as a ROS 2 node on rmw_cyclonedds_cpp: it shares no code with armcell.

Run as a process of its own; reads commands as JSON lines, answers each with one JSON line.

    python peer.py DOMAIN [CONFIG]
"""

import dataclasses
import json
import sys
import threading
import time
import traceback
from pathlib import Path
from typing import get_args, get_type_hints

sys.path.insert(0, str(Path(__file__).parent))

import rmw_types as t
from cyclonedds import _clayer
from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

SECOND = 10**9


def filled(cls, values):
    """A struct of plain dicts and lists."""
    hints = get_type_hints(cls)
    made = cls()
    for name, value in values.items():
        hint = hints[name]
        inner = getattr(hint, "subtype", None) or next(iter(get_args(hint)), None)
        inner = getattr(inner, "subtype", inner)
        if isinstance(value, dict):
            value = filled(hint, value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            value = [filled(inner, v) for v in value]
        setattr(made, name, value)
    return made


def qos(reliable=True, latched=False, depth=10, user_data=""):
    policies = [
        Policy.Reliability.Reliable(SECOND) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(depth) if depth else Policy.History.KeepAll,
    ]
    if user_data:
        policies.append(Policy.Userdata(user_data.encode()))
    return Qos(*policies)


class Peer:
    def __init__(self, domain, config):
        self.domain = Domain(domain, config)
        self.participant = DomainParticipant(domain, qos=Qos(Policy.Userdata(b"enclave=/;")))
        self.topics, self.writers, self.readers, self.clients = {}, {}, {}, {}
        self.endpoints = [
            BuiltinDataReader(self.participant, topic)
            for topic in (BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription)
        ]
        self.seq = 0
        self.lock = threading.Lock()

    def topic(self, name, cls):
        if (name, cls) not in self.topics:
            self.topics[name, cls] = Topic(self.participant, name, cls)
        return self.topics[name, cls]

    # --- topics ---
    def advertise(self, topic, type, **policies):
        self.writers[topic] = DataWriter(
            self.participant, self.topic(topic, getattr(t, type)), qos=qos(**policies)
        )

    def subscribe(self, topic, type, **policies):
        self.readers[topic] = DataReader(
            self.participant, self.topic(topic, getattr(t, type)), qos=qos(**policies)
        )

    def drop(self, topic):
        self.writers.pop(topic, None)
        self.readers.pop(topic, None)

    def publish(self, topic, fields):
        writer = self.writers[topic]
        writer.write(filled(writer.data_type, fields))

    def publish_bytes(self, topic, data):
        """Whatever bytes, past the encoder; whether the library took them."""
        return _clayer.ddspy_write(self.writers[topic]._ref, bytes.fromhex(data))

    def take(self, topic, count=1, timeout=5.0):
        found, end = [], time.monotonic() + timeout
        while len(found) < count and time.monotonic() < end:
            found += [
                dataclasses.asdict(s) for s in self.readers[topic].take(100) if isinstance(s, IdlStruct)
            ]
            time.sleep(0.005)
        return found

    def matched(self, topic):
        if topic in self.writers:
            return len(self.writers[topic].get_matched_subscriptions())
        return len(self.readers[topic].get_matched_publications())

    def found(self):
        """Every endpoint that discovery has told of: topic, type, user data."""
        names = []
        for reader in self.endpoints:
            for e in reader.read(1000):
                if e.sample_info.instance_state == 16 and e.participant_key != self.participant.guid:
                    user = [p.data.decode() for p in e.qos if p.__scope__ == "Userdata"]
                    names.append([e.topic_name, e.type_name, "".join(user), e.key.hex])
        return names

    # --- services ---
    def client(self, service, name):
        """Endpoints of a client of `rq<service>`; `name` begins its types' names."""
        if service not in self.clients:
            user_data = f"clientid={len(self.clients)}.{self.participant.guid.hex};"
            made = (
                DataWriter(
                    self.participant, self.topic(f"rq{service}Request", getattr(t, f"{name}Request")),
                    qos=qos(user_data=user_data),
                ),
                DataReader(
                    self.participant, self.topic(f"rr{service}Reply", getattr(t, f"{name}Response")),
                    qos=qos(user_data=user_data),
                ),
            )  # fmt: skip
            self.clients[service] = made
        return self.clients[service]

    def call(self, service, name, request, timeout=5.0, wait=True):
        writer, reader = self.client(service, name)
        end = time.monotonic() + timeout
        while not (writer.get_matched_subscriptions() and reader.get_matched_publications()):
            if time.monotonic() > end:
                return "no server"
            time.sleep(0.005)
        self.seq += 1
        own = writer.get_instance_handle() & (2**64 - 1)
        writer.write(filled(writer.data_type, {**request, "guid": own, "seq": self.seq}))
        return self.answer(service, name, self.seq, end - time.monotonic()) if wait else self.seq

    def answer(self, service, name, seq, timeout=5.0):
        writer, reader = self.client(service, name)
        own, end = writer.get_instance_handle() & (2**64 - 1), time.monotonic() + timeout
        while time.monotonic() < end:
            for sample in reader.take(100):
                if isinstance(sample, IdlStruct) and sample.guid == own and sample.seq == seq:
                    return dataclasses.asdict(sample)
            time.sleep(0.002)
        return "no answer"

    def serve(self, service, name, respond):
        """Answer in a thread of its own: `respond(request)` gives the response's fields, or None: later."""
        user_data = f"serviceid={service}.{self.participant.guid.hex};"
        reader = DataReader(
            self.participant, self.topic(f"rq{service}Request", getattr(t, f"{name}Request")),
            qos=qos(user_data=user_data),
        )  # fmt: skip
        writer = DataWriter(
            self.participant, self.topic(f"rr{service}Reply", getattr(t, f"{name}Response")),
            qos=qos(user_data=user_data),
        )  # fmt: skip

        def reply(request, fields):
            writer.write(filled(writer.data_type, {**fields, "guid": request.guid, "seq": request.seq}))

        def loop():
            while True:
                for request in reader.take(10):
                    if isinstance(request, IdlStruct):
                        fields = respond(request)
                        if fields is not None:
                            reply(request, fields)
                time.sleep(0.002)

        threading.Thread(target=loop, daemon=True).start()
        return reply

    def serve_trigger(self, service, message, delay=0.0):
        def respond(request):
            time.sleep(delay)
            return {"success": True, "message": message}

        self.serve(service, "Trigger", respond)

    # --- an action server: a gripper that takes a while ---
    def serve_gripper(self, name, seconds, accept=True):
        goals = {}
        self.advertise(f"rt{name}/_action/feedback", "GripperFeedbackMessage")
        self.advertise(f"rt{name}/_action/status", "GoalStatusArray", latched=True, depth=1)

        def work(uuid, goal):
            status = 4
            for i in range(10):
                if goal["cancel"].wait(seconds / 10):
                    status = 5
                    break
                feedback = {"goal_id": {"uuid": uuid}, "feedback": {"position": (i + 1) / 10}}
                self.publish(f"rt{name}/_action/feedback", feedback)
            goal["result"] = {
                "status": status, "result": {"position": goal["position"], "reached_goal": status == 4}
            }  # fmt: skip
            for request in goal["waiting"]:
                reply(request, goal["result"])

        def on_goal(request):
            uuid = list(request.goal_id.uuid)
            if accept:
                goal = {"cancel": threading.Event(), "result": None, "waiting": []}
                goal["position"] = request.goal.command.position
                goals[bytes(uuid)] = goal
                threading.Thread(target=work, args=(uuid, goal), daemon=True).start()
            return {"accepted": accept}

        def on_cancel(request):
            goal = goals.get(bytes(request.goal_info.goal_id.uuid))
            if goal is None:
                return {"return_code": 2}
            goal["cancel"].set()
            return {"return_code": 0, "goals_canceling": [dataclasses.asdict(request.goal_info)]}

        def on_get(request):
            goal = goals[bytes(request.goal_id.uuid)]
            if goal["result"] is None:
                goal["waiting"].append(request)
            return goal["result"]

        self.serve(f"{name}/_action/send_goal", "GripperSendGoal", on_goal)
        self.serve(f"{name}/_action/cancel_goal", "CancelGoal", on_cancel)
        reply = self.serve(f"{name}/_action/get_result", "GripperGetResult", on_get)

    def serve_arm(self, name, joints, start):
        """A joint_trajectory_controller with its arm, and joint states 50 times a second.

        As ros2_control's: it refuses a goal that does not name all joints, and follows the others along
        straight lines in joint space, in the time they ask for.
        """
        q, now, results, waiting = dict(zip(joints, start)), {}, {}, {}
        self.taken = []
        self.advertise(f"rt{name}/_action/feedback", "FollowFeedbackMessage")
        self.advertise(f"rt{name}/_action/status", "GoalStatusArray", latched=True, depth=1)
        self.advertise("rt/joint_states", "JointState")

        def publish():
            while True:
                stamp = {"sec": int(time.time()), "nanosec": time.time_ns() % SECOND}
                state = {"header": {"stamp": stamp}, "name": list(q), "position": list(q.values())}
                self.publish("rt/joint_states", {**state, "velocity": [0.0] * len(q)})
                time.sleep(0.02)

        def work(uuid, trajectory):
            first, last = dict(q), trajectory.points[-1]
            seconds = last.time_from_start.sec + last.time_from_start.nanosec / SECOND
            began, status = time.monotonic(), 4
            while (passed := time.monotonic() - began) < seconds:
                if now["cancel"].wait(0.01):
                    status = 5
                    break
                for joint, end in zip(trajectory.joint_names, last.positions):
                    q[joint] = first[joint] + (end - first[joint]) * passed / seconds
            if status == 4:
                q.update(zip(trajectory.joint_names, last.positions))
            finish(uuid, {"status": status, "result": {"error_code": 0}})

        def finish(uuid, result):
            results[uuid] = result
            for request in waiting.pop(uuid, []):
                reply(request, result)

        def on_goal(request):
            trajectory = request.goal.trajectory
            self.taken.append([list(trajectory.joint_names), len(trajectory.points)])
            accepted = set(trajectory.joint_names) == set(q)
            if accepted:
                now["cancel"] = threading.Event()
                args = (bytes(request.goal_id.uuid), trajectory)
                threading.Thread(target=work, args=args, daemon=True).start()
            return {"accepted": accepted}

        def on_cancel(request):
            now["cancel"].set()
            return {"return_code": 0, "goals_canceling": [dataclasses.asdict(request.goal_info)]}

        def on_get(request):
            uuid = bytes(request.goal_id.uuid)
            if uuid not in results:
                waiting.setdefault(uuid, []).append(request)
            return results.get(uuid)

        self.serve(f"{name}/_action/send_goal", "FollowSendGoal", on_goal)
        self.serve(f"{name}/_action/cancel_goal", "CancelGoal", on_cancel)
        reply = self.serve(f"{name}/_action/get_result", "FollowGetResult", on_get)
        threading.Thread(target=publish, daemon=True).start()

    def goals_taken(self):
        """Joint names and numbers of points of the goals that came."""
        return self.taken

    def node(self, namespace, name):
        """Announce a node, as rmw_dds_common does."""
        self.advertise("ros_discovery_info", "ParticipantEntitiesInfo", latched=True, depth=1)
        info = {"node_namespace": namespace, "node_name": name}
        gid = {"data": list(self.participant.guid.bytes)}
        self.publish("ros_discovery_info", {"gid": gid, "node_entities_info_seq": [info]})


def main():
    config = sys.argv[2] if len(sys.argv) > 2 else None
    peer = Peer(int(sys.argv[1]), config)
    print(json.dumps("ready"), flush=True)
    for line in sys.stdin:
        command = json.loads(line)
        try:
            answer = {"ok": getattr(peer, command.pop("do"))(**command)}
        except Exception:
            answer = {"error": traceback.format_exc()}
        print(json.dumps(answer, default=list), flush=True)


if __name__ == "__main__":
    main()

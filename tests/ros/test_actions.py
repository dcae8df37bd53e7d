"""Actions over five topics, with actionlib's states."""

import threading
import time
from itertools import pairwise

import pytest

from armcell.core import InputError, UnknownNameError
from armcell.ros import ActionClient, ActionOutcome, ActionServer, Bus, GoalState, schema

S = schema()
TYPE = "control_msgs/GripperCommand"
RESULT = schema().message(f"{TYPE}Result")


def goal(position=0.0):
    message = schema().new(f"{TYPE}Goal")
    message.command.position = position
    return message


def until_cancelled(g):
    if g.cancel.wait(5):
        return ActionOutcome(GoalState.PREEMPTED, RESULT(position=g.message.command.position))
    return ActionOutcome(GoalState.ABORTED, RESULT())


def wait_for(condition, timeout=5.0):
    end = time.monotonic() + timeout
    while not condition() and time.monotonic() < end:
        time.sleep(0.002)
    assert condition()


def test_goal_feedback_result():
    bus, seen = Bus(), []

    def execute(g):
        for _ in range(20):
            g.feedback(schema().new(f"{TYPE}Feedback", position=0.5))
        return ActionOutcome(
            GoalState.SUCCEEDED, RESULT(position=g.message.command.position, reached_goal=True), "there"
        )

    with ActionServer(bus, "gripper_cmd", TYPE, execute), ActionClient(bus, "/gripper_cmd", TYPE) as client:
        sent = client.send_goal(goal(0.25), seen.append)
        assert sent.wait(5)
        assert (sent.state, sent.text, sent.result.position) == (GoalState.SUCCEEDED, "there", 0.25)
        assert [f.position for f in seen] == [0.5] * 20  # all before the result


def test_status_is_told_at_five_hertz_and_names_the_goal():
    bus = Bus()
    with ActionServer(bus, "a", TYPE, until_cancelled), ActionClient(bus, "a", TYPE) as client:
        status = bus.subscribe("a/status", "actionlib_msgs/GoalStatusArray", queue_size=100)
        sent = client.send_goal(goal())
        wait_for(lambda: sent.state is GoalState.ACTIVE)
        while status.get(timeout=0):
            pass
        start = time.monotonic()
        for _ in range(5):
            message = status.get(timeout=2)
            assert message.status_list[0].goal_id.id == sent.id.id
        assert 0.7 < time.monotonic() - start < 20.0


# What may follow in the status of one goal: wiki.ros.org/actionlib/DetailedDescription, server states.
FOLLOWS = {
    None: {GoalState.PENDING, GoalState.ACTIVE},
    GoalState.PENDING: {GoalState.ACTIVE, GoalState.REJECTED, GoalState.RECALLING, GoalState.RECALLED},
    GoalState.RECALLING: {GoalState.PREEMPTING, GoalState.REJECTED, GoalState.RECALLED},
    GoalState.ACTIVE: {GoalState.PREEMPTING, GoalState.SUCCEEDED, GoalState.ABORTED, GoalState.PREEMPTED},
    GoalState.PREEMPTING: {GoalState.PREEMPTED, GoalState.SUCCEEDED, GoalState.ABORTED},
}


def states_of(status, sent):
    """The different states of a goal on its status topic, in order, until it is over."""
    states = [None]
    while states[-1] is None or not states[-1].is_terminal:
        message = status.get(timeout=5)
        assert message is not None, states
        now = [GoalState(s.status) for s in message.status_list if s.goal_id.id == sent.id.id]
        states += [s for s in now if s is not states[-1]]
    assert all(after in FOLLOWS[before] for before, after in pairwise(states)), states
    return states[1:]


@pytest.mark.slow
@pytest.mark.parametrize("accepts", [True, False])
@pytest.mark.parametrize("cancelled", [True, False])
@pytest.mark.parametrize("explicit", [True, False])
@pytest.mark.parametrize(
    "end",
    [GoalState.SUCCEEDED, GoalState.ABORTED, GoalState.REJECTED, GoalState.PREEMPTED, GoalState.RECALLED],
)
def test_every_end_of_a_goal_is_a_transition_of_actionlib(accepts, cancelled, explicit, end):
    bus, begun = Bus(), threading.Event()

    def execute(g):
        begun.set()
        if explicit:
            g.accept()
        if cancelled:
            assert g.cancel.wait(5)
        return ActionOutcome(end, RESULT(), "why")

    server = ActionServer(bus, "a", TYPE, execute, accepts=accepts)
    status = bus.subscribe("a/status", "actionlib_msgs/GoalStatusArray", queue_size=100)
    with server, ActionClient(bus, "a", TYPE) as client:
        sent = client.send_goal(goal())
        if cancelled:
            assert begun.wait(5)
            sent.cancel()
        assert sent.wait(5) and sent.text.endswith("why")
        states = states_of(status, sent)
        assert sent.state is states[-1]
        if end is GoalState.REJECTED and not (accepts or explicit):
            assert GoalState.ACTIVE not in states and states[-1] is GoalState.REJECTED
        if end is GoalState.REJECTED and (accepts or explicit):
            assert states[-1] is GoalState.ABORTED


@pytest.mark.parametrize("how", ["id", "all", "time", "other time"])
def test_cancelling(how):
    bus = Bus()
    with ActionServer(bus, "a", TYPE, until_cancelled), ActionClient(bus, "a", TYPE) as client:
        sent = client.send_goal(goal(0.1))
        wait_for(lambda: sent.state is GoalState.ACTIVE)
        cancel = bus.advertise("a/cancel", "actionlib_msgs/GoalID")
        stamps = {"time": sent.id.stamp.to_sec() + 0.001, "other time": sent.id.stamp.to_sec() - 1.0}
        stamp = type(sent.id.stamp).from_sec(stamps.get(how, 0.0))
        cancel.publish(
            schema().new("actionlib_msgs/GoalID", stamp=stamp, id=sent.id.id if how == "id" else "")
        )
        if how == "other time":
            assert not sent.wait(0.1)
            sent.cancel()
        assert sent.wait(5) and sent.state is GoalState.PREEMPTED and sent.result.position == 0.1


def test_a_newer_goal_takes_over_and_the_older_ends_first():
    bus, order = Bus(), []

    def execute(g):
        order.append(g.message.command.position)
        return until_cancelled(g)

    with ActionServer(bus, "a", TYPE, execute), ActionClient(bus, "a", TYPE) as client:
        sent = [client.send_goal(goal(float(i))) for i in (1,)]
        wait_for(lambda: sent[0].state is GoalState.ACTIVE)
        sent.append(client.send_goal(goal(2.0)))
        assert sent[0].wait(5) and sent[0].state is GoalState.PREEMPTED
        wait_for(lambda: sent[1].state is GoalState.ACTIVE)
        assert order == [1.0, 2.0]


def test_concurrent_goals_run_side_by_side():
    bus, both = Bus(), threading.Barrier(2)

    def execute(g):
        both.wait(5)
        return ActionOutcome(GoalState.SUCCEEDED, RESULT())

    with ActionServer(bus, "a", TYPE, execute, concurrent=True), ActionClient(bus, "a", TYPE) as client:
        sent = [client.send_goal(goal()) for _ in range(2)]
        assert all(s.wait(5) and s.state is GoalState.SUCCEEDED for s in sent)


def test_a_failing_execute_is_aborted_with_the_reason():
    bus = Bus()

    def execute(g):
        raise ValueError("no such joint")

    with ActionServer(bus, "a", TYPE, execute), ActionClient(bus, "a", TYPE) as client:
        sent = client.send_goal(goal())
        assert sent.wait(5)
        assert sent.state is GoalState.ABORTED and sent.text == "ValueError: no such joint"


def test_what_cannot_be_done_is_aborted_with_the_plain_reason(caplog):
    bus = Bus()

    def execute(g):
        raise InputError("no joint states yet", hint="start the simulator")

    with ActionServer(bus, "a", TYPE, execute), ActionClient(bus, "a", TYPE) as client:
        sent = client.send_goal(goal())
        assert sent.wait(5) and sent.state is GoalState.ABORTED
        assert sent.text == "no joint states yet (start the simulator)"
    assert [r.levelname for r in caplog.records] == ["WARNING"]


def test_goals_without_ids_are_all_taken():
    bus, count = Bus(), []

    def execute(g):
        count.append(g.id.id)
        return ActionOutcome(GoalState.SUCCEEDED, RESULT())

    bus.clock.set(1.0)  # both come at the same time
    with ActionServer(bus, "a", TYPE, execute, concurrent=True):
        publisher = bus.advertise("a/goal", f"{TYPE}ActionGoal")
        for _ in range(2):
            publisher.publish(schema().new(f"{TYPE}ActionGoal"))
        wait_for(lambda: len(count) == 2)
        assert len(set(count)) == 2


def test_the_same_goal_twice_is_taken_once():
    bus, count = Bus(), []

    def execute(g):
        count.append(g)
        return ActionOutcome(GoalState.SUCCEEDED, RESULT())

    with ActionServer(bus, "a", TYPE, execute):
        publisher = bus.advertise("a/goal", f"{TYPE}ActionGoal")
        results = bus.subscribe("a/result", f"{TYPE}ActionResult")
        message = schema().new(f"{TYPE}ActionGoal")
        message.goal_id.id = "one"
        publisher.publish(message)
        publisher.publish(message)
        assert results.get(5).status.goal_id.id == "one"
        assert results.get(0.1) is None and len(count) == 1


def test_unknown_action():
    with pytest.raises(UnknownNameError, match="action type"):
        ActionServer(Bus(), "a", "control_msgs/GripperComand", until_cancelled)


def test_a_flood_of_goals_is_rejected_beyond_a_bound():
    bus = Bus()
    with (
        ActionServer(bus, "a", TYPE, until_cancelled, concurrent=True),
        ActionClient(bus, "a", TYPE) as client,
    ):
        sent = []
        for _ in range(40):
            sent.append(client.send_goal(goal()))
            time.sleep(0.005)  # the goal queue itself is bounded too
        wait_for(lambda: sum(s.state is GoalState.REJECTED for s in sent) == 8)
        assert threading.active_count() < 60
        client.cancel_all()
        assert all(s.wait(5) for s in sent)


def test_a_goal_that_fails_has_no_result_that_reads_as_a_success(bus):
    """Whatever the server's function left empty, and where it raises."""
    follow, place = "control_msgs/FollowJointTrajectory", "moveit_msgs/Place"

    def end(action, execute):
        with ActionServer(bus, "/ends", action, execute), ActionClient(bus, "/ends", action) as client:
            assert client.wait_for_server(5)
            sent = client.send_goal(S.new(f"{action}Goal"))
            assert sent.wait(5)
            return sent.result

    def raise_(goal):
        raise InputError("no such arm")

    result = end(follow, lambda goal: ActionOutcome(GoalState.ABORTED, S.new(f"{follow}Result"), "it fell"))
    assert (result.error_code, result.error_string) == (-1, "it fell")
    result = end(follow, raise_)
    assert (result.error_code, result.error_string) == (-1, "no such arm")
    code = end(place, raise_).error_code
    assert (code.val, code.message, code.source) == (99999, "no such arm", "armcell")
    code = end(place, lambda goal: ActionOutcome(GoalState.PREEMPTED, S.new(f"{place}Result"), "")).error_code
    assert code.val == -7
    own = S.new(f"{place}Result", S.new("moveit_msgs/MoveItErrorCodes", -19, "no cup", "shelf"))
    code = end(place, lambda goal: ActionOutcome(GoalState.ABORTED, own, "")).error_code
    assert (code.val, code.message, code.source) == (-19, "no cup", "shelf")

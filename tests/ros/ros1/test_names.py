"""Names, remappings and addresses, by the rules of wiki.ros.org/Names and ROS/EnvironmentVariables."""

from __future__ import annotations

import pytest

from armcell.core import InputError
from armcell.ros.names import NameMap, resolve_program_name
from armcell.ros.ros1 import Ros1Settings, from_environment


@pytest.mark.parametrize(
    ("name", "full"),
    [
        ("/a/b", "/a/b"), ("a", "/ns/a"), ("a/b", "/ns/a/b"), ("~a", "/ns/n/a"), ("~/a/b", "/ns/n/a/b"),
        ("a//b/", "/ns/a/b"),
    ],
)  # fmt: skip
def test_resolving(name, full):
    assert resolve_program_name(name, "/ns/n", "/ns") == full


def test_a_namespace_holds_the_whole_cell_but_what_is_global():
    names = NameMap("n", "/left")
    assert names.node == "/left/n"
    assert names.to_graph("/joint_states") == "/left/joint_states"
    assert names.to_bus("/left/joint_states") == "/joint_states"
    for name in ("/tf", "/clock", "/rosout"):
        assert names.to_graph(name) == name == names.to_bus(name)
    assert names.to_bus("/other") == "/other"


def test_remapping_goes_both_ways():
    names = NameMap("n", "/", {"joint_states": "/panda/joint_states", "~x": "y"})
    assert names.to_graph("/joint_states") == "/panda/joint_states"
    assert names.to_bus("/panda/joint_states") == "/joint_states"
    assert names.to_graph("/n/x") == "/y"
    with pytest.raises(InputError, match="both remapped"):
        NameMap("n", "/", {"a": "c", "b": "c"})


def test_settings_from_the_environment():
    bare = from_environment("cell", environment={})
    assert bare == Ros1Settings("cell")
    assert bare.host == bare.bind == "127.0.0.1" and bare.master_address == ("localhost", 11311)
    env = {"ROS_MASTER_URI": "http://robot:11312", "ROS_IP": "10.0.0.3", "ROS_NAMESPACE": "left"}
    s = from_environment("cell", environment=env)
    assert (s.host, s.bind, s.namespace) == ("10.0.0.3", "0.0.0.0", "/left")
    assert s.master_address == ("robot", 11312)
    assert from_environment("cell", environment={"ROS_IP": "127.0.0.1"}).is_local
    assert from_environment("cell", environment={"ROS_HOSTNAME": "a", "ROS_IP": "b"}).host == "a"
    bound = from_environment("cell", bind="10.0.0.7", environment={})
    assert (bound.host, bound.bind) == ("10.0.0.7", "10.0.0.7")


def test_settings_from_remapping_arguments():
    s = from_environment(
        "cell",
        ["a:=b", "__name:=other", "__ns:=/left", "_speed:=2.5", "__master:=http://m:1", "__ip:=10.0.0.9"],
        environment={},
    )  # fmt: skip
    assert (s.name, s.namespace) == ("other", "/left")
    assert (s.remap, s.parameters) == ({"a": "b"}, {"speed": 2.5})
    assert s.master == "http://m:1" and s.host == "10.0.0.9"


@pytest.mark.parametrize(
    "change",
    [
        {"arguments": ["nonsense"]}, {"arguments": [":=x"]}, {"environment": {"ROS_MASTER_URI": "robot:1"}},
        {"environment": {"ROS_IP": "http://10.0.0.3"}}, {"arguments": ["__name:=a/b"]},
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(change):
    with pytest.raises(InputError, match=r"remapping|address|name"):
        from_environment("cell", **{"environment": {}, **change})

"""What `armcell serve` and `armcell sim` say of wrong options for ROS 2."""

import sys

import pytest
from tests.cli.helpers import call

WRONG = {
    ("serve", "panda_pick"): "give --unity, --ros1, --ros2 or --wire",
    ("serve", "panda_pick", "--unity", "--domain", "3"): "it goes with --ros2",
    ("sim", "panda_pick"): "--connect HOST:PORT, or --ros1 or --ros2",
    (
        "sim",
        "panda_pick",
        "--ros2",
        "--connect",
        "127.0.0.1:10000",
    ): "--connect HOST:PORT, or --ros1 or --ros2",
    ("sim", "panda_pick", "--connect", "127.0.0.1:10000", "--domain", "3"): "it goes with --ros2",
}


@pytest.mark.parametrize("arguments", WRONG, ids=" ".join)
def test_wrong_options(capsys, arguments):
    said = call(capsys, *arguments)
    assert said.status == 1 and WRONG[arguments] in " ".join(said.err.split())


def test_a_domain_that_does_not_exist(capsys, monkeypatch):
    assert call(capsys, "serve", "panda_pick", "--ros2", "--domain", "233").status == 2
    pytest.importorskip("cyclonedds", reason="cyclonedds is not installed (pip install 'armcell[ros2]')")
    for variable, value in (
        ("ROS_DOMAIN_ID", "one"), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FAR"), ("ROS_STATIC_PEERS", "<a>")
    ):  # fmt: skip
        with monkeypatch.context() as patch:
            patch.setenv(variable, value)
            said = call(capsys, "serve", "panda_pick", "--ros2")
            assert said.status == 1 and value in said.err


def test_without_the_extra(capsys, monkeypatch):
    from armcell.ros.ros2.dds import library

    library.cache_clear()
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    said = call(capsys, "serve", "panda_pick", "--ros2")
    library.cache_clear()
    assert said.status == 1 and "pip install 'armcell[ros2]'" in said.err

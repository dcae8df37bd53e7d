"""Generated Python classes work with the codecs like the built-in ones."""

import sys
from pathlib import Path

import pytest
from tests import programs

import armcell
from armcell.core import UnknownNameError
from armcell.ros.message_generators import generate_python, write
from armcell.ros.schema import schema

USE = """
import moveit_msgs.msg as m, moveit_msgs.srv as s, geometry_msgs.msg as g
from armcell.ros.codec import cdr_codec, ros1_codec
from armcell.ros.schema import schema
box = m.CollisionObject(id="box", operation=m.CollisionObject.MOVE)
box.primitive_poses = [g.Pose(g.Point(1, 2, 3))]
for codec in (ros1_codec(), cdr_codec()):
    back = codec.decode("moveit_msgs/CollisionObject", codec.encode(box))
    assert back.id == "box" and back.primitive_poses[0].position.z == 3 and back.operation == 3
for name in schema().messages:
    if name.startswith("moveit_msgs/"):
        cls = getattr(m, name.split("/")[1])
        assert bytes(ros1_codec().encode(cls())) == bytes(ros1_codec().encode(schema().new(name))), name
        assert cls._md5sum == schema().md5(name)
assert s.GetPositionIK._request_class().ik_request.timeout.to_sec() == 0
"""


@pytest.mark.slow
def test_generated_package_is_used(tmp_path):
    files = write(generate_python(schema(), ["moveit_msgs"]), tmp_path)
    assert tmp_path / "geometry_msgs" / "msg.py" in files  # what it uses comes along
    source = Path(armcell.__file__).parents[1]
    done = programs.run(
        [sys.executable, "-c", USE],
        env={"PYTHONPATH": f"{tmp_path}:{source}"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


def test_unknown_package():
    with pytest.raises(UnknownNameError, match="message package"):
        generate_python(schema(), ["nope_msgs"])

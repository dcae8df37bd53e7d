"""What a robot description may read: files of its own packages, and nothing of the user's."""

from __future__ import annotations

import os

import pytest

from armcell.core import InputError
from armcell.model import load_robot
from armcell.model.assets import find_package, resolve_uri
from armcell.model.xacro import ALLOW_ENV, expand_xacro

ROBOT = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'
NAME = "<package><name>{}</name></package>"


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A user's folder: a secret, a workspace with two packages, another person's file in downloads."""
    for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", ALLOW_ENV):
        monkeypatch.delenv(variable, raising=False)
    files = {
        "secret.yaml": "password: hunter2",
        "secret.xml": "<secret>hunter2</secret>",
        "work/src/arm/package.xml": NAME.format("arm"),
        "work/src/arm/config/arm.yaml": "mass: 2",
        "work/src/arm/urdf/part.xacro": ROBOT.format('<link name="part"/>'),
        "work/src/clone_of_hand/package.xml": NAME.format("hand"),
        "work/src/clone_of_hand/hand.yaml": "mass: 3",
        "plain/hand.yaml": "mass: 4",
        "downloads/notes.txt": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def robot(folder, inside: str):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "r.xacro").write_text(ROBOT.format(inside))
    return folder / "r.xacro"


def yaml(name: str) -> str:
    return f"<link name=\"${{xacro.load_yaml('{name}')}}\"/>"


def include(name: str) -> str:
    return f'<xacro:include filename="{name}"/>'


# The inside of $(...) ends at the first parenthesis, in plain xacro as well: a call needs a property.
EVAL = '<xacro:property name="p" value="{}"/><link name="$(eval ${{p}})"/>'
OUTSIDE = [
    yaml("{home}/secret.yaml"), yaml("../secret.yaml"), yaml("$(find downloads)/../secret.yaml"),
    yaml("a/../../secret.yaml"), yaml("link.yaml"), yaml("folder/secret.yaml"), yaml("/etc/passwd"),
    yaml("$(find arm)/../../../secret.yaml"), yaml("$(dirname)/../secret.yaml"),
    yaml("$(cwd)/../secret.yaml"),
    include("{home}/secret.xml"), include("../secret.xml"), include("../*.xml"), include("*/secret.xml"),
    include("folder/*.xml"), include("/e*c/*"), include("link.xml"), include("../plain/../secret.xml"),
    include("*/../../secret.xml"), EVAL.format("find('downloads')"),
    "<l v=\"${load_yaml('../secret.yaml')}\"/>",
]  # fmt: skip


@pytest.mark.parametrize("inside", OUTSIDE)
def test_a_file_outside_the_packages_is_refused(home, inside):
    file = robot(home / "downloads", inside.replace("{home}", str(home)))
    (home / "downloads" / "a").mkdir()
    (home / "downloads" / "link.yaml").symlink_to(home / "secret.yaml")
    (home / "downloads" / "link.xml").symlink_to(home / "secret.xml")
    (home / "downloads" / "folder").symlink_to(home)
    with pytest.raises(InputError) as error:
        expand_xacro(file)
    said = str(error.value)
    assert said.startswith(str(file)) and "\n" not in said and "hunter2" not in said
    assert "outside the robot's packages" in said or "package" in said or "wildcard" in said


def test_files_of_its_own_package_are_read_from_any_folder_of_it(home, monkeypatch):
    monkeypatch.chdir(home)
    file = robot(
        home / "work" / "src" / "arm" / "urdf",
        yaml("../config/arm.yaml") + yaml("$(find arm)/config/arm.yaml") + include("part.xacro")
        + include("$(find arm)/urdf/p*.xacro"),
    )  # fmt: skip
    assert expand_xacro(file).count("{'mass': 2}") == 2
    assert expand_xacro(file).count('name="part"') == 2


def test_a_package_is_found_by_its_own_name_beside_and_by_the_search_path(home, monkeypatch):
    file = robot(home / "work" / "src" / "clone_of_hand" / "urdf", yaml("$(find hand)/hand.yaml"))
    assert "{'mass': 3}" in expand_xacro(file)
    file = robot(home / "work" / "src" / "arm" / "urdf", yaml("$(find hand)/hand.yaml"))
    assert "{'mass': 3}" in expand_xacro(file)  # in the workspace, though its folder has another name
    os.rename(home / "work" / "src" / "clone_of_hand", home / "work" / "src" / "hand")
    assert "{'mass': 3}" in expand_xacro(file)
    file = robot(home / "downloads", yaml("$(find hand)/hand.yaml"))
    with pytest.raises(InputError, match="package 'hand' not found.*ROS_PACKAGE_PATH"):
        expand_xacro(file)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(home / "work" / "src"))
    assert "{'mass': 3}" in expand_xacro(file)


def test_a_folder_above_is_no_package_by_its_name_alone(home):
    """Or `$(find home)` would open the user's whole folder."""
    with pytest.raises(InputError, match="not found"):
        find_package(home.name, home / "downloads")
    with pytest.raises(InputError, match="not found"):
        find_package("plain", home / "downloads")
    for name in ("..", ".", "", "a/b", "/etc", "\0"):
        with pytest.raises(InputError, match="not found"):
            find_package(name, home / "downloads")
        with pytest.raises(InputError):
            resolve_uri(f"package://{name}/secret.yaml", home / "downloads")


def test_colcon_s_links_into_the_source_are_followed(home, monkeypatch):
    """`colcon build --symlink-install` makes each installed file a link to the source."""
    share = home / "work" / "install" / "share" / "arm"
    (share / "config").mkdir(parents=True)
    for name in ("package.xml", "config/arm.yaml"):
        (share / name).symlink_to(home / "work" / "src" / "arm" / name)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(home / "work" / "install"))
    assert "{'mass': 2}" in expand_xacro(robot(home / "downloads", yaml("$(find arm)/config/arm.yaml")))


def test_a_robot_folder_is_one_package(home):
    """robot.yaml names a file in a folder of it, which includes another."""
    folder = home / "cell"
    robot(folder / "urdf", include("../parts/base.xacro"))
    robot(folder / "parts", '<link name="base"/>').rename(folder / "parts" / "base.xacro")
    (folder / "robot.yaml").write_text("urdf: urdf/r.xacro\n")
    assert list(load_robot(folder).links) == ["base"]
    with pytest.raises(InputError, match="outside the robot's packages"):
        load_robot(folder / "urdf" / "r.xacro")


ENV = '<link name="$(env SECRET)"/>'


@pytest.mark.parametrize(
    "inside",
    [
        ENV, '<link name="$(optenv SECRET none)"/>', EVAL.format("env('SECRET')"),
        EVAL.format("optenv('SECRET')"),
        '<xacro:property name="a" value="$(env SECRET)"/><link name="${a}"/>',
    ],
)  # fmt: skip
def test_the_environment_is_read_with_permission_only(home, monkeypatch, inside):
    monkeypatch.setenv("SECRET", "hunter2")
    file = robot(home / "downloads", inside)
    with pytest.raises(InputError, match=r"environment variable 'SECRET'.*--allow-env") as error:
        load_robot(file)
    assert "hunter2" not in str(error.value)
    assert list(load_robot(file, allow_env=True).links) == ["hunter2"]
    monkeypatch.setenv(ALLOW_ENV, "1")
    assert list(load_robot(file).links) == ["hunter2"]
    with pytest.raises(InputError, match="needs permission"):
        load_robot(file, allow_env=False)


def test_permission_reaches_parts_and_packages(home, monkeypatch):
    monkeypatch.setenv("SECRET", "hunter2")
    robot(home / "cell", ENV)
    (home / "cell" / "robot.yaml").write_text("parts: [{robot: r.xacro}]\n")
    with pytest.raises(InputError, match="needs permission"):
        load_robot(home / "cell")
    assert "hunter2" in load_robot(home / "cell", allow_env=True).links
    (home / "cell" / "cell.yaml").write_text("robot: .\n")
    from armcell.cell import load, with_values

    assert "hunter2" in load(home / "cell", allow_env=True).model.links
    moved = with_values(load(home / "cell", allow_env=True), {"robot": {"model": ".", "pose": [0, 0, 1]}})
    assert "hunter2" in moved.model.links


def test_an_unset_variable_and_a_default(home, monkeypatch):
    monkeypatch.delenv("UNSET", raising=False)
    file = robot(home / "downloads", '<link name="$(optenv UNSET a b)"/>')
    assert 'name="a b"' in expand_xacro(file, allow_env=True)
    with pytest.raises(InputError, match="'UNSET' is not set"):
        expand_xacro(robot(home / "downloads", '<link name="$(env UNSET)"/>'), allow_env=True)

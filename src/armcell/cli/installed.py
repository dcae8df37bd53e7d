"""The packages that armcell requires, and the extras with the optional packages."""

from __future__ import annotations

NEEDED = (
    "coal", "example-robot-data", "lxml", "matplotlib", "mcap", "mujoco", "networkx", "numba", "numpy",
    "ompl", "pillow", "pycollada", "pydantic", "pyyaml", "rich", "rosbags", "ruckig", "scipy", "trimesh",
    "typer", "viser",
)  # fmt: skip
EXTRAS = {
    "vision": ("opencv-python-headless",),
    "ik": ("eaik",),
    "ros2": ("cyclonedds",),
    "trees": ("py_trees",),
    "ray": ("ray",),
    "ur-rtde": ("ur_rtde",),
    "franka": ("franky-control",),
}

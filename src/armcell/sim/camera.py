"""Cameras."""
from __future__ import annotations
from dataclasses import dataclass
import numpy as np
from armcell.core import SE3

@dataclass(frozen=True, eq=False)
class Camera:
    name: str
    T_world_camera: SE3
    width: int = 640
    height: int = 480
    fovy_deg: float = 45.0

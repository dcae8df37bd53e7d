"""Franka arms (FR3, Panda) in pure Python over Franka's Control Interface; kind `franka`."""

from armcell.drivers.franka.robot_kind import FrankaKind

__all__ = ["FrankaKind"]

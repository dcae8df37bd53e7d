"""Emulated robot controllers, which speak the vendors' own protocols."""

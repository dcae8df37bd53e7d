"""Drivers by mode. Importing this package registers them."""

from armcell.control.drivers import fake, sim, ur

__all__ = ["fake", "sim", "ur"]

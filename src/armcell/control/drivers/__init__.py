"""Drivers by mode. Importing this package registers them."""

from armcell.control.drivers import fake, sim

__all__ = ["fake", "sim"]

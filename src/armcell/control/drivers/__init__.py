"""Robot drivers by mode (sim, fake, real); importing this package registers them."""

from armcell.control.drivers import fake, sim, ur

__all__ = ["fake", "sim", "ur"]

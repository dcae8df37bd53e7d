"""Safe expansion of xacro files: macros, properties and expressions, without running code."""

from armcell.model.xacro.expand import ALLOW_ENV, Place, expand_with_source_locations, expand_xacro

__all__ = ["ALLOW_ENV", "Place", "expand_with_source_locations", "expand_xacro"]

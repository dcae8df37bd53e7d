"""Replacements for ROS's Python modules, which scripts import; they work on the armcell bus."""

"""Modules that replace those of ROS for scripts; all of them work on the armcell bus."""

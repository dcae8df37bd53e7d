"""Modules that stand where a script expects ROS's own: thin, everything is done on the bus."""

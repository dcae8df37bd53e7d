"""Shim of moveit_commander.exception."""


class MoveItCommanderException(Exception):
    """Error: moveit_commander cannot carry out a request; the text contains the reason."""

"""Shim of moveit_commander.exception."""


class MoveItCommanderException(Exception):
    """moveit_commander's exception: a request cannot be carried out; the text contains the reason."""

"""Shim of moveit_commander.exception."""


class MoveItCommanderException(Exception):
    """Exception of moveit_commander for a request that cannot be carried out. Its text states the reason."""

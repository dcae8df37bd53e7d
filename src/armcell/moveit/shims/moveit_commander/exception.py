"""moveit_commander.exception."""


class MoveItCommanderException(Exception):
    """What was asked cannot be done; says why."""

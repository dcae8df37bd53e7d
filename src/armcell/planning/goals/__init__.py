"""Goals of a request as joint positions.

User targets, inverse kinematics, sampled goal regions.
"""

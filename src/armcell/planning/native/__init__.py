"""The native planner: RRT-Connect, shortcuts and proofs in one compiled piece."""

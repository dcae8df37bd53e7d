"""armcell's planner beside others, on public problems, in one process."""

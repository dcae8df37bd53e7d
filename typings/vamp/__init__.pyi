# VAMP is not in the development set (see benchmarks/planning/peers/vamp.py): everything in it is Any.
from typing import Any

def __getattr__(name: str) -> Any: ...

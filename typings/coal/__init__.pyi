# coal ships no type stubs and hides behind a .pth file: everything in it is Any.
from typing import Any

def __getattr__(name: str) -> Any: ...

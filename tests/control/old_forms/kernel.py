from collections.abc import Callable
from typing import Any, NamedTuple


class Kernel(NamedTuple):
    settings: Callable[..., Any]
    state: Callable[[], Any]
    memory: Callable[..., Any]
    step: Callable[..., Any]

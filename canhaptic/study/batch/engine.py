"""What computes a batch: NumPy, or machine code compiled by numba; both give the same bits."""

from importlib.util import find_spec
from typing import Final, Literal

from canhaptic.errors import ParameterError

Engine = Literal["auto", "numpy", "numba"]
"""As asked for."""
ChosenEngine = Literal["numpy", "numba"]

WORTH_COMPILING: Final = 2e7
"""Scenes times cycles from which compiling pays."""


def chosen_engine(engine: Engine, pays: bool) -> ChosenEngine:
    """Returns the engine that "auto" stands for here.

    Args:
        engine: As asked for.
        pays: Whether compiling takes less time than it saves.

    Raises:
        ParameterError: An unknown name, or numba is asked for and not installed.
    """
    if engine not in ("auto", "numpy", "numba"):
        raise ParameterError(f"engine: got {engine!r}, expected auto, numpy or numba")
    there = find_spec("numba") is not None
    if engine == "numba" and not there:
        raise ParameterError("engine: got numba, which is not installed; pip install 'canhaptic[fast]', or take numpy")
    if engine == "auto":
        return "numba" if there and pays else "numpy"
    return engine

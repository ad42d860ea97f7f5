"""Choice of the engine of a batch: machine code compiled by numba, or Python; both give the same bits."""

from importlib.util import find_spec
from typing import Final, Literal

from canhaptic.errors import ParameterError
from canhaptic.extras import install_hint

Engine = Literal["auto", "numba", "python"]
"""As requested."""
ChosenEngine = Literal["numba", "python"]

WORTH_COMPILING: Final = 1e6
"""Scenes times cycles from which compiling pays: Python takes 5 us for each (`unprotected`) to 60 us (`guarded`, a stop
and friction), and compiling 4 to 14 s once for a kind of scene; compiled code takes 0.5 us at most."""

WORTH_COMPILING_GROUPS: Final = 3e5
"""The same for groups, for each of which Python takes some 150 us, compiling 20 s once."""


def chosen_engine(engine: Engine, pays: bool) -> ChosenEngine:
    """Return the engine that "auto" chooses here.

    Args:
        engine: Requested engine.
        pays: Whether compiling takes less time than it saves.

    Raises:
        ParameterError: An unknown name, or numba is requested and not installed.
    """
    if engine not in ("auto", "numba", "python"):
        raise ParameterError(f"engine: got {engine!r}, expected auto, numba or python")
    there = find_spec("numba") is not None
    if engine == "numba" and not there:
        raise ParameterError(f"engine: got numba, which is not installed; {install_hint('fast')}, or use python")
    if engine == "auto":
        return "numba" if there and pays else "python"
    return engine

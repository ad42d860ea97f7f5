"""Simulate many scenes in one call: the engine of a sweep, compiled where numba is installed, else interpreted.

    reason = why_not_batchable(scene)            # "" or the reason by name
    run_batch(scene, {"environment.stiffness": k, "bus.rate": rates}, cycles=1000, engine="auto")
    run_scalar(scene, cycles=1000)               # the same figures of one scene, with any plant

**One source.** The controller's kernels (`canhaptic.kernels`), the plant and the sums of the figures run in one loop
(`closed_loop`). The same source runs in Python and as machine code, with equal bits; only sine and exponential may
differ in their last bit, because they come from the C library. A linear plant moves by its transition matrix over a
hold, a plant with events by the stepper of `canhaptic.sim.plant` (both in `plants`). Scenes are computed one after the
other and are independent.

Compiling takes some 5 s, once for each algorithm and environment; the machine code is stored on disk (`compiler`).

`chosen_engine` chooses between machine code and Python; both give the same bits.
"""

import os
from importlib.metadata import version
from importlib.util import find_spec
from typing import Final, Literal

from canhaptic.errors import ParameterError
from canhaptic.extras import install_hint

Engine = Literal["auto", "numba", "python"]
"""Engine as a user requests it."""
ChosenEngine = Literal["numba", "python"]

WORTH_COMPILING: Final = 1e6
"""Scenes times cycles from which compiling pays. Python takes 5 us (`unprotected`) to 60 us (`guarded`, a stop and
friction) a cycle, compiled code at most 0.5 us; compiling takes 3 to 8 s, once for a kind of scene."""

WORTH_COMPILING_EVENTS: Final = 1e5
"""The same for plants with events, 60 to 90 us a cycle in Python; the first scenes of a sweep are timed."""

WORTH_COMPILING_GROUPS: Final = 3e5
"""The same for groups: Python takes some 150 us a cycle, and compiling 10 s."""
_FOREIGN: Final = ".numba_config.yaml"
_KNOWN: Final = ((0, 63), (0, 68))
"""First and last version of numba with which `canhaptic.kernels.linking` was run; the extra `fast` asks for these."""


def why_no_numba() -> str:
    """Return "" if numba, which compiles the loops, can be used, else why not."""
    if find_spec("numba") is None:
        return "which is not installed"
    found = version("numba")
    first, last = (".".join(map(str, of)) for of in _KNOWN)
    is_known = _KNOWN[0] <= tuple(int(part) for part in found.split(".")[:2]) <= _KNOWN[1]
    return "" if is_known else f"whose version {found} is not one of {first} to {last}"


def without_numba() -> str:
    """Return the note that Python computes because numba cannot."""
    reason = f"numba, {why_no_numba()}, cannot compile: computed in Python, about 100 times slower"
    return f"{reason}; {install_hint('fast')} installs it"


def chosen_engine(engine: Engine, pays: bool) -> ChosenEngine:
    """Return the engine to use; "auto" chooses the faster one.

    Args:
        engine: Requested engine.
        pays: Whether compiling saves more time than it takes.

    Raises:
        ParameterError: The name is unknown, numba is requested but not installed or of a version that was never
            tried, or the current folder has a file with settings of numba.
    """
    if engine not in ("auto", "numba", "python"):
        raise ParameterError(f"engine: got {engine!r}, expected auto, numba or python")
    missing = why_no_numba()
    if engine == "numba" and missing:
        raise ParameterError(f"engine: got numba, {missing}; {install_hint('fast')}, or use python")
    chosen: ChosenEngine = ("python" if missing or not pays else "numba") if engine == "auto" else engine
    if chosen == "numba" and os.path.lexists(_FOREIGN):
        raise ParameterError(f"engine: numba would read {_FOREIGN} of this folder; move it away, or use python")
    return chosen

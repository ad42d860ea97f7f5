"""A group of axes whose whole step runs compiled by numba; needs the extra `fast`.

Formulas are those of the controller that it is made from: its source is unfolded into one function of plain numbers
(`unfolding`) and compiled when the controller is built, never in the running cycle. The compiled function is kept in
the cache folder of numba, by its text: compiling takes some seconds once for each structure of scene and version.

The interpreted controller stays beside it for what happens seldom: the first sample, lost samples, a mechanism outside
its limits, an error. Its steps and the compiled ones share one state.
"""

import hashlib
import importlib.util
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numba
import numpy as np

from canhaptic.control.balance import EnergyBalance
from canhaptic.control.multi_axis.group_controller import GroupBalance
from canhaptic.control.multi_axis.unfolding.group_step import NAMES, StandIn, unfold

_WARMING = 4  # steps after which the state has its shape


class CompiledGroup:
    """A group whose step is compiled; see `GroupController`.

    Attributes:
        axes: Motor axes.
        interpreted: Steps that the interpreted controller made.
        source: Of the compiled function.
    """

    def __init__(self, build: Callable[[Any], Any], kinematics: Any) -> None:
        """Builds, unfolds and compiles.

        Args:
            build: Makes the interpreted controller on a mechanism.
            kinematics: The mechanism.

        Raises:
            ParameterError: Something in it is a function of one's own, or it does not fit together.
        """
        self._group = group = build(kinematics)
        twin = build(StandIn(kinematics))
        self.axes, self.interpreted = group.axes, 0
        still = (0.0,) * self.axes
        for _ in range(_WARMING):
            twin.step(still, still)
        self._unfolded = unfolded = unfold(group, twin)
        self.source = unfolded.source
        self._run = compiled(unfolded.functions, unfolded.source)
        self._numbers = np.zeros(unfolded.memory.size)
        self._before = np.zeros(unfolded.memory.size)
        self._beside = np.array(unfolded.beside, dtype=np.int64)
        for first, values in unfolded.constants.items():
            self._numbers[first : first + len(values)] = values
        for first, value in unfolded.memory.parameters.items():
            self._numbers[first] = value
        self._view: Any = memoryview(self._numbers.data)
        self._out = unfolded.outputs
        self._in_motion = False

    def reset(self) -> None:
        """Forgets everything; see `GroupController`."""
        self._leave()
        self._group.reset()

    def hold(self) -> GroupBalance:
        """Repeats the last commands for want of a sample; see `GroupController`."""
        self._leave()
        balance: GroupBalance = self._group.hold()
        return balance

    def step(self, positions: Sequence[float], torques_applied: Sequence[float]) -> GroupBalance:
        """Books the hold that ended; see `GroupController`."""
        axes, view = self.axes, self._view
        if not (self._in_motion and len(positions) == axes == len(torques_applied)):
            return self._interpret(positions, torques_applied)
        for i in range(axes):
            view[i] = positions[i]
            view[axes + i] = torques_applied[i]
        if not self._run(self._numbers, self._before, self._beside):
            self._numbers[:] = self._before
            return self._interpret(positions, torques_applied)
        found = view[self._out :].tolist()
        account = found[axes : axes + 15]
        account[11], account[13] = int(account[11]), int(account[13])
        rest = 15 + axes
        return GroupBalance(
            tuple(found[:axes]), EnergyBalance._make(account), tuple(found[rest : rest + axes]),
            found[rest + axes], found[rest + axes + 1], int(found[rest + axes + 2]),
        )  # fmt: skip

    def _interpret(self, positions: Sequence[float], torques_applied: Sequence[float]) -> GroupBalance:
        self._leave()
        self.interpreted += 1
        balance: GroupBalance = self._group.step(positions, torques_applied)
        self._in_motion = self._unfolded.memory.store(self._numbers)
        return balance

    def _leave(self) -> None:
        """Gives the state back to the interpreted controller."""
        if self._in_motion:
            self._unfolded.memory.restore(self._numbers)
            self._in_motion = False


def compiled(functions: str, source: str) -> Callable[..., bool]:
    """Returns a step, from the cache or compiled now.

    Args:
        functions: Source of what it calls; compiled once for all networks.
        source: Of the step.
    """
    called = _loaded(functions)
    function: Callable[..., bool] = _loaded(
        source.replace(NAMES, f"{NAMES}from {called.__name__} import *\n")
    ).group_step
    return function


def _loaded(source: str) -> Any:
    """Returns a source as a module with a file, as the cache of numba needs it."""
    digest = hashlib.sha256(f"{numba.__version__} {source}".encode()).hexdigest()[:24]
    name = f"canhaptic_compiled_{digest}"
    if name in sys.modules:
        return sys.modules[name]
    path = _folder() / f"{name}.py"
    if not path.exists() or path.read_text(encoding="utf-8") != source:
        handle, unfinished = tempfile.mkstemp(dir=path.parent)
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(source)
        os.replace(unfinished, path)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)  # numba finds what it has cached by this name
    spec.loader.exec_module(module)
    return module


def _folder() -> Path:
    """Returns where sources and compiled functions are kept; a fresh folder where no other can be written."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    folder = Path(getattr(numba.config, "CACHE_DIR", "") or home) / "canhaptic"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return Path(tempfile.mkdtemp(prefix="canhaptic_"))

"""The loop side of a group: one thing changed at a time, sample rate, delay, algorithm, torque step, encoder count."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from canhaptic.axis_units import effort_unit
from canhaptic.control.multi_axis import GROUP_ALGORITHMS
from canhaptic.control.multi_axis.group_controller import GroupController
from canhaptic.errors import ParameterError
from canhaptic.lab.batch.engine import WORTH_COMPILING, WORTH_COMPILING_GROUPS, ChosenEngine
from canhaptic.lab.batch.group_loop import GroupRecorder
from canhaptic.lab.batch.group_rows import render_group_by
from canhaptic.lab.loop.algorithms import group_under
from canhaptic.lab.loop.axis_loop import Array, Case, LoopRun
from canhaptic.lab.loop.scenes import at_rate
from canhaptic.lab.studies.accuracy.loop_sensitivity import RATES, Variant, fineness, hertz
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import build_group
from canhaptic.scene.timing import with_timing
from canhaptic.scene.torque_history import simulation_of
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters

_SUBSTEPS: Final = 8
"""Substeps of the plants in one sample time: of order 2, the error of a mechanism is far below that of its loop."""
_TRAVELS: Final = 10.0
"""Distance from the origin that counts as divergence, in that of the continuous run."""


@dataclass(frozen=True, slots=True)
class _GroupCase(Case):
    """The group of a scene."""

    scene: Scene

    @property
    def sample_time_ns(self) -> int:
        """T [ns]."""
        return self.scene.bus.sample_time_ns

    def controller(self) -> GroupController:
        """Return the algorithm, at rest."""
        (group,) = self.scene.groups
        return build_group(self.scene, group)


@dataclass(frozen=True, slots=True, kw_only=True)
class _GroupVariant(Variant):
    """The loop of a group."""

    case: _GroupCase

    def render(self, cycles: int, motion: Array, tick: Callable[[], None], engine: ChosenEngine) -> LoopRun:
        """Return what it did; see `Variant`."""
        furthest = _TRAVELS * float(np.abs(motion).max()) + float(np.ptp(motion, axis=0).max())
        return render_group_by(engine, self.case.scene, cycles, GroupRecorder(motion.shape[1], furthest, tick))

    def work(self, cycles: int) -> tuple[str, float]:
        """Return the algorithm with what decides the lengths of its buffers, and the cost of a run; see `Variant`."""
        (group,), bus = self.case.scene.groups, self.bus
        is_coarse = any(axis.loop.encoder_count for axis in self.case.scene.axes)
        compiled = f"{group.passivity.name} {bus.sample_time_ns} {bus.delay} {is_coarse}"
        return compiled, cycles * WORTH_COMPILING / WORTH_COMPILING_GROUPS


def finely_solved(scene: Scene, factor: float = 1.0) -> Scene:
    """Return a scene with plants of substeps of the same length at `factor` times the rate."""
    substeps = max(1, round(_SUBSTEPS / factor))

    def fine(axis: AxisScene) -> AxisScene:
        if axis.simulation is None:
            return axis
        accuracy = AccuracyParameters(substeps=substeps)
        return replace(axis, simulation=replace(simulation_of(axis), accuracy=accuracy))

    mechanisms = tuple(replace(of, substeps=substeps) for of in scene.mechanisms)
    return replace(scene, axes=tuple(map(fine, scene.axes)), mechanisms=mechanisms)


def group_variants(scene: Scene) -> list[Variant]:
    """Return the one group of a scene and everything next to it, one change each, on finely solved plants."""
    (group,) = scene.groups
    base = finely_solved(scene)
    found = [_variant("as it is", group.passivity.name, base, is_scene=True)]
    for factor in RATES:
        rate = scene.bus.rate * factor
        if 1.0 <= rate <= 20_000.0 and (factor <= 1.0 or not scene.bus.sample_time_ns % int(factor)):
            changed = finely_solved(at_rate(scene, rate), factor)
            found.append(_variant("sample rate", hertz(rate), changed, fineness=factor))
    return [*found, *_delays(base), *_algorithms(base), *_torques(base), *_encoders(base)]


def _variant(kind: str, setting: str, scene: Scene, **rest: Any) -> Variant:
    buses = tuple(axis.bus for axis in scene.axes)
    return _GroupVariant(group=kind, setting=setting, buses=buses, bus=scene.bus, case=_GroupCase(scene), **rest)


def _delays(base: Scene) -> list[Variant]:
    other = "event" if base.bus.rpdo == "synchronous" else "synchronous"
    bus = base.bus.model_copy(update={"rpdo": other})
    changes = {"delay": bus.delay, "torque_window": None}
    timed = with_timing(replace(_with_loops(base, lambda _axis: changes), bus=bus))
    if any((axis.loop.torque_window or 0.0) >= bus.sample_time for axis in timed.axes):
        return []  # the torque would come behind the next SYNC
    return [_variant("RPDO", other, timed)]


def _algorithms(base: Scene) -> list[Variant]:
    (group,), found = base.groups, []
    for name in GROUP_ALGORITHMS:
        changed = replace(base, groups=(group_under(group, name),))
        try:
            build_group(changed, changed.groups[0])
        except ParameterError:
            continue
        if name != group.passivity.name:
            found.append(_variant("algorithm", name, changed))
    return found


def _torques(base: Scene) -> list[Variant]:
    if any(axis.parameters.rated_torque is None for axis in base.axes):
        return []
    unit, quantum = effort_unit(base.axes[0].parameters.unit), base.axes[0].loop.torque_quantum
    found = []
    for factor in (0.1, 10.0, None):

        def change(axis: AxisScene, factor: float | None = factor) -> Mapping[str, float | None]:
            return {"torque_quantum": (axis.loop.torque_quantum or 0.0) * (factor or 0.0)}

        def parameters(axis: AxisScene, factor: float | None = factor) -> Mapping[str, float | None]:
            return {"rated_torque": None if factor is None else (axis.parameters.rated_torque or 0.0) * factor}

        setting = "ideal" if factor is None else f"{(quantum or 0.0) * factor:g} {unit}"
        changed = _with_loops(base, change, parameters)
        found.append(_variant("torque step", setting, changed, fineness=fineness(factor, -1.0)))
    return found


def _encoders(base: Scene) -> list[Variant]:
    found, given = [], base.axes[0].parameters
    for factor in (0.01, 0.1, 10.0, None):

        def change(axis: AxisScene, factor: float | None = factor) -> Mapping[str, float | None]:
            return {"encoder_count": 0.0 if factor is None else axis.loop.encoder_count / factor}

        def parameters(axis: AxisScene, factor: float | None = factor) -> Mapping[str, float | None]:
            return {"counts_per_unit": axis.parameters.counts_per_unit * (factor or 0.0)}

        setting = "ideal" if factor is None else f"{1.0 / (abs(given.counts_per_unit) * factor):.3g} {given.unit}"
        changed = _with_loops(base, change, parameters)
        found.append(_variant("encoder count", setting, changed, fineness=fineness(factor, 1.0)))
    return found


_Changes = Callable[[AxisScene], Mapping[str, float | None]]


def _with_loops(scene: Scene, loop: _Changes, parameters: _Changes = lambda _axis: {}) -> Scene:
    """Return the scene with changes to what is known of the loop of every axis, and to its drive."""
    axes = tuple(
        replace(
            axis, loop=axis.loop.model_copy(update=loop(axis)),
            parameters=axis.parameters.model_copy(update=parameters(axis)),
        )
        for axis in scene.axes
    )  # fmt: skip
    return replace(scene, axes=axes)

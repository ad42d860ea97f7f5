"""Causes of a ripple, each tested against the log: evidence in numbers, and the value of a key that calms it.

A cause gets a weight from 0 to 1: how much of the ripple it explains by the log. The tests are of three kinds.

- *Steps*: the torque of one encoder count, or one step of the torque, against the torque's swing.
- *The loop*: whether wall, mass and delay grow as declared, and whether they do with the delay that the log shows
  (`sampled_loop`). What makes a stable loop grow is the cause.
- *The answer*: whether the mass moves as the torque says. A lag, a limit or steps of the motor that the drive does not
  report are found by the one that explains the acceleration best; a hand, by a wall that takes energy out at its rate.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import inf, pi
from typing import Any, Final, NamedTuple, TypedDict

import numpy as np

from canhaptic.audit.why.ripple import Array, Buzz, Motion, buzz_of, least_step, motion_of, residues
from canhaptic.audit.why.sampled_loop import SampledLoop
from canhaptic.axis_units import effort_unit
from canhaptic.control.damping import largest_stable_damping
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.scene.models import AxisScene, Scene

_COMPARED: Final = 16
"""Windows on which motion and torque are compared."""
_KEEPS_DAMPING: Final = ("unprotected", "guarded")
"""Algorithms whose damper is that of the wall; others add one of their own."""
_HARDLY: Final = 1e-6
"""Value of a twin's fault without effect: a twin whose bus has no fault at all lacks the section."""
_LEAST_LATE: Final = 0.1
"""Part of a hold from which a torque counts as late."""
_UNTESTED: Final = 0.1
"""Weight of a hand that trembles where no test speaks for it."""
_LIKELY: Final = 0.5
"""Weight of a cause from which a run names its ripple unasked."""
_FELT: Final = 0.05
"""Share of the torque from which it does."""
_TRIED: Final = 80
"""Steps of the torque that are tried where the drive reports none."""


class Cause(TypedDict):
    """A cause: its name, what was measured, and the key whose value calms it."""

    cause: str
    key: str
    value: float | str | None
    evidence: str
    weight: float  # of the ripple that it explains, 0 to 1


class Why(TypedDict):
    """What trembles on an axis, and why."""

    frequency: float  # [Hz]
    amplitude: float  # of the position, peak to peak [m or rad]
    torque: float  # peak to peak [N or N*m]
    share: float  # of the torque
    ripple: float  # over that of a wall without it
    phase: float  # of the torque ahead of minus the motion [rad]
    chatter: float  # contacts per second
    kind: str
    contacts: list[dict[str, float]]  # start [s], frequency, amplitude and torque of each that trembles
    missing: list[str]  # signals that the log does not have
    causes: list[Cause]


@dataclass(frozen=True, slots=True)
class Known:
    """What a scene declares of an axis; None: not declared."""

    axis: str = ""
    place: int = 0
    period: float = 1e-3  # [s]
    delay: float = 1.0  # holds
    unit: str = "m"
    stiffness: float | None = None
    damping: float = 0.0
    count: float = 0.0
    quantum: float = 0.0
    limit: float = inf
    mass: float | None = None
    lost: float = 0.0  # damping of device and hand
    wall: str = "environment"  # path of its section
    effects: Mapping[str, tuple[int, Any]] = field(default_factory=dict)  # of a twin: type -> (place, parameters)
    effects_at: str = "simulation.effects"
    algorithm: str = ""
    frames_late: float = 0.0  # by which a twin's bus delays torques [holds]
    late_by: tuple[str, float | str] | None = None  # key of a twin that makes frames late, and its value without
    skipped_by: tuple[str, float | str] | None = None  # the same of skipped SYNCs
    coupled: str = ""  # name of the group in which it is joined to another handle
    coupled_to: tuple[str, ...] = ()

    @property
    def weight(self) -> float:
        """Mass for the force of a ripple; a light handle where none is declared [kg or kg*m^2]."""
        return self.mass or (0.2 if self.unit == "m" else 0.2 * 0.06**2)


def known_of(scene: Scene, name: str) -> Known:
    """Return what a scene declares of an axis."""
    axis = scene.axis(name)
    place, given = [of.parameters.name for of in scene.axes].index(name), axis.parameters
    port, twin = scene.port_of(axis), axis.simulation
    rendered = port.rendered.parameters
    plant, hand = getattr(twin, "plant", None), getattr(twin, "user", None)
    mass = getattr(plant, "mass", None) or (axis.loop.moving_mass if port.axes == (axis,) else None)
    effects: dict[str, tuple[int, Any]] = {
        of.name: (n, of.parameters) for n, of in enumerate(twin.effects if twin else ())
    }
    if mass and "shaft_compliance" in effects:
        mass += effects["shaft_compliance"][1].load_mass
    lost = (getattr(plant, "damping", None) or axis.loop.device_damping or 0.0) + (getattr(hand, "damping", 0.0) or 0.0)
    written = given.rated_torque
    return Known(
        name, place, scene.bus.sample_time, axis.loop.delay, given.unit,
        getattr(rendered, "stiffness", None), getattr(rendered, "damping", 0.0) or 0.0,
        1.0 / abs(given.counts_per_unit), axis.loop.torque_quantum or (written or 0.0) / 1000.0,
        given.torque_limit or inf, mass, lost, _path_of(scene, place, axis),
        effects,
        _effects_at(scene, name), port.passivity.name,
        *_faults_of(scene, axis),
        port.name if port.rendered.name == "coupled_handles" else "",
        tuple(of.parameters.name for of in port.axes if of is not axis),
    )  # fmt: skip


def _faults_of(scene: Scene, axis: AxisScene) -> tuple[float, tuple[str, float | str] | None, Any]:
    """Return by how many holds a twin's bus delays torques, and the keys of its late frames and skipped SYNCs."""
    bus, drive = scene.bus_effects, axis.simulation.drive if axis.simulation else None
    if bus is None:
        return 0.0, ("simulation.drive.syncs_late", 0.0) if drive is not None and drive.syncs_late else None, None
    late = (bus.delay + 0.5 * bus.jitter) / scene.bus.sample_time if bus.suffers("to_drive") else 0.0
    worst = next((key for key in ("drop", "reorder", "delay", "jitter") if getattr(bus, key)), "")
    skipping = next((key for key in ("stall", "freeze") if getattr(bus, key)), "")
    return (
        late,
        (f"simulation.bus.{worst}", _HARDLY) if worst else None,
        (f"simulation.bus.{skipping}.0.duration", _HARDLY) if skipping else None,
    )


def _path_of(scene: Scene, place: int, axis: AxisScene) -> str:
    """Return the path of the section that makes the wall, for an override."""
    of_axis = (
        f"axes.{place}.environment" if len(scene.axes) > 1 and "\nenvironment" not in scene.text else "environment"
    )
    return scene.port_of(axis).section or of_axis


def _effects_at(scene: Scene, name: str) -> str:
    return "simulation.effects" if "\n  effects" in scene.text else f"simulation.axes.{name}.effects"


class Seen(NamedTuple):
    """A ripple with all that its causes are tested on."""

    known: Known
    motion: Motion
    buzz: Buzz
    loop: SampledLoop | None  # as declared; None without a wall of a known stiffness, or without a mass
    late: float  # holds by which torques act later than declared
    others: Mapping[str, Buzz | None]

    @property
    def swing(self) -> float:
        """Largest torque to and fro [N or N*m]."""
        return max(self.buzz.torque, 1e-12)

    @property
    def grows(self) -> bool:
        """Whether the loop is unstable as declared."""
        return self.loop is not None and self.loop.grows

    @property
    def skipped(self) -> float:
        """Share of the SYNCs that were skipped."""
        gaps = self.motion.gaps
        return 0.0 if gaps is None or not len(gaps) else float((gaps - 1).clip(0).sum() / gaps.sum())

    @property
    def line(self) -> str:
        """Growth of the loop as declared, in words."""
        if self.loop is None:
            return ""
        mode = self.loop.slowest()
        return f"the loop as declared {'grows' if mode.growth > 0.0 else 'decays'} at {mode.frequency:.3g} Hz"

    def cause(self, cause: str, weight: float, evidence: str, key: str = "", value: float | str | None = None) -> Cause:
        """Return a cause of this ripple."""
        return {"cause": cause, "key": key, "value": value, "evidence": evidence, "weight": min(1.0, weight)}

    def wall(self, loop: SampledLoop | None) -> tuple[str, float | str | None]:
        """Return key and value of the first wall that is calm in a loop; none without one."""
        if loop is None:
            return f"{self.known.wall}.stiffness", None
        for calmer in loop.calmer():
            if calmer.calm():
                key = "stiffness" if calmer.stiffness != loop.stiffness else "damping"
                return f"{self.known.wall}.{key}", float(f"{getattr(calmer, key):.3g}")
        return f"{self.known.wall}.stiffness", float(f"{loop.stiffness / 128.0:.3g}")


def why(log: EnergyLog, scene: Scene | None, rows: slice | None = None) -> dict[str, Why]:
    """Return what trembles on each axis of a log, with its causes; nothing of an axis that is calm.

    Args:
        log: An open energy log.
        scene: The scene of the run; None: found, but not explained.
        rows: Part of the log.
    """
    found: dict[str, tuple[Known, Motion, Buzz | None]] = {}
    for name in log.axes:
        known = Known(name, period=log.sample_time) if scene is None else known_of(scene, name)
        motion = motion_of(log, name, rows)
        found[name] = known, motion, buzz_of(motion, known.weight)
    buzzes = {name: buzz for name, (_, _, buzz) in found.items()}
    seen = {n: explained(known, motion, buzz, buzzes) for n, (known, motion, buzz) in found.items() if buzz is not None}
    return {name: one for name, one in seen.items() if not _is_the_hand(one)}


def _is_the_hand(found: Why) -> bool:
    """Whether every cause was tested and none was found: what moves is the hand that plays."""
    return bool(found["causes"]) and found["causes"][0]["weight"] <= _UNTESTED


def is_worth_a_line(found: Why) -> bool:
    """Whether a run says unasked that it buzzes: a part of the torque that is felt, by a cause that the log shows."""
    causes = found["causes"]
    return bool(causes) and causes[0]["weight"] >= _LIKELY and found["share"] >= _FELT


def explained(known: Known, motion: Motion, buzz: Buzz, others: Mapping[str, Buzz | None]) -> Why:
    """Return a ripple in numbers, with its causes in order of their weight."""
    loop, late = None, _lateness(known, motion, buzz)
    if known.stiffness is not None and known.mass:
        loop = SampledLoop(known.stiffness, known.damping, known.delay, known.mass, known.lost, known.period)
    seen = Seen(known, motion, buzz, loop, late, others)
    causes = sorted((cause for test in TESTS for cause in test(seen)), key=lambda cause: -cause["weight"])
    phase, missing = buzz.phase, [] if motion.torque is not None else ["applied torque (0x6074 or 0x6077)"]
    return {
        "frequency": buzz.frequency, "amplitude": buzz.amplitude, "torque": buzz.torque, "share": buzz.share,
        "ripple": buzz.ripple, "phase": phase, "chatter": buzz.chatter, "kind": _kind(buzz, causes),
        "contacts": _stretches(known, motion), "missing": missing, "causes": causes,
    }  # fmt: skip


def _kind(buzz: Buzz, causes: list[Cause]) -> str:
    if causes and causes[0]["cause"] == "a hand that trembles":
        return "tremor"
    return "limit cycle" if buzz.purity >= 0.5 else "noise"


def _stretches(known: Known, motion: Motion) -> list[dict[str, float]]:
    """Return the contacts that tremble; breaks of less than a tenth of a second belong to a contact."""
    if motion.touches is None or not motion.touches.any():
        return []
    rows = np.flatnonzero(motion.touches)
    breaks = np.flatnonzero(np.diff(rows) > 0.1 / motion.period)
    found = []
    for first, last in zip(rows[[0, *(breaks + 1)]], rows[[*breaks, -1]], strict=True):
        buzz = buzz_of(motion.part(slice(int(first), int(last) + 1)), known.weight)
        if buzz is not None:
            figures = {"frequency": buzz.frequency, "amplitude": buzz.amplitude, "torque": buzz.torque}
            found.append({"start": float(first * motion.period), **figures})
    return found


# --- what the log shows and no scene says ---------------------------------------------------------------------------


def _windows(buzz: Buzz, values: Array, shift: int = 0) -> Array:
    """Return the windows that tremble, without their cubic parts, of a signal shifted by some rows."""
    return residues(np.roll(values, shift), buzz.windows[buzz.windows >= shift][:_COMPARED], buzz.size)


def _lateness(known: Known, motion: Motion, buzz: Buzz) -> float:
    """Return the mean number of holds by which applied torques follow the commands later than declared."""
    if motion.torque is None or motion.command is None or not len(buzz.windows):
        return 0.0
    lags = np.arange(1, 11)
    starts = buzz.windows[buzz.windows >= lags[-1]]
    if not len(starts):
        return 0.0
    applied = residues(motion.torque, starts, buzz.size)
    limit = np.abs(motion.torque).max()
    command = np.clip(motion.command, -limit, limit)
    rests = np.array([np.abs(applied - residues(np.roll(command, lag), starts, buzz.size)).mean() for lag in lags])
    best = int(np.argmin(rests))
    if rests[best] > 0.5 * np.abs(applied).mean() or not np.abs(applied).mean():
        return 0.0
    within = max(motion.answer / known.period, known.frames_late) if known.delay == 0 else 0.0
    return float(max(0.0, lags[best] - 1.0 - known.delay)) + (within if within > _LEAST_LATE else 0.0)


def _unexplained(seen: Seen, torque: Array) -> float:
    """Return the share of the acceleration, in the windows that tremble, that a torque of the motor leaves open."""
    motion = seen.motion
    moved = np.diff(motion.position, 2, prepend=0.0, append=0.0)
    pushed = torque + np.roll(torque, -1)  # of the holds before and after each position
    first, second = (_windows(seen.buzz, of, 1)[:, 4:-4].ravel() for of in (moved, pushed))
    size = float(second @ second)
    if not size or not float(first @ first):
        return 1.0
    return float(1.0 - (first @ second) ** 2 / (size * (first @ first)))


def _best(seen: Seen, values: list[float], change: Callable[[Array, float], Array]) -> tuple[float, float]:
    """Return the value of a change of the torque that explains the motion best, and the share that it leaves open less.

    The share is of what the torque as reported leaves open: 0 for a change that explains no more.
    """
    torque = seen.motion.torque
    if torque is None or not len(seen.buzz.windows):
        return 0.0, 0.0
    plain = _unexplained(seen, torque)
    rests = [_unexplained(seen, change(torque, value)) for value in values]
    best = int(np.argmin(rests))
    return values[best], max(0.0, 1.0 - rests[best] / max(plain, 1e-12))


def _lagged(torque: Array, lag: float) -> Array:
    """Return the mean torque of each hold behind a lag, in sample times."""
    decay = float(np.exp(-1.0 / lag))
    taps = decay ** np.arange(max(2, min(200, int(8.0 * lag))))
    kernel = np.concatenate(([1.0 - lag * (1.0 - decay)], lag * (1.0 - decay) ** 2 * taps))
    return np.asarray(np.convolve(torque, kernel)[: len(torque)])


# --- the tests --------------------------------------------------------------------------------------------------------


def _encoder(seen: Seen) -> Iterator[Cause]:
    known = seen.known
    count, damping = known.count or seen.motion.count, known.damping
    force = count * (damping / known.period + (known.stiffness or 0.0))
    if not count or not force or not (seen.buzz.in_contact or known.coupled):
        return
    weight = min(1.0, force / (0.35 * seen.swing)) * (
        0.6 + 0.4 * min(1.0, 6.0 * count / max(seen.buzz.amplitude, count))
    )
    effort = effort_unit(known.unit)
    evidence = (
        f"one count ({count:.3g} {known.unit}) changes the torque of the damper by {force:.3g} {effort}; "
        f"the torque swings by {seen.swing:.3g} {effort}"
    )
    least = seen.loop and replace(seen.loop, damping=0.2 * damping)
    if least is not None and least.calm() and known.algorithm in _KEEPS_DAMPING:
        yield seen.cause("encoder count x damping", weight, evidence, f"{known.wall}.damping", 0.2 * damping)
    else:
        key, value = f"axes.{known.place}.counts_per_unit", float(f"{10.0 / count:.4g}")
        yield seen.cause("encoder count x damping", weight, evidence, key, value)


def _torque_step(seen: Seen) -> Iterator[Cause]:
    if not seen.buzz.torque:
        return
    known, effort = seen.known, effort_unit(seen.known.unit)
    step = max(known.quantum, least_step(seen.motion.torque) if seen.motion.torque is not None else 0.0)
    weight = min(1.0, step / (0.35 * seen.swing)) if step else 0.0
    key: str = f"axes.{known.place}.rated_torque"
    value: float = float(f"{100.0 * step:.4g}")
    if "torque_quantisation" in known.effects:
        place, parameters = known.effects["torque_quantisation"]
        step, weight = parameters.quantum, max(weight, min(1.0, parameters.quantum / (0.35 * seen.swing)))
        key, value = f"{known.effects_at}.{place}.quantum", 0.05 * step
    else:
        peak = max(1e-9, float(np.abs(seen.motion.torque).max())) if seen.motion.torque is not None else 1.0
        grid = np.geomspace(0.04 * peak, 1.5 * peak, _TRIED).tolist()
        found, gained = _best(seen, grid, lambda torque, size: np.round(torque / size) * size)
        if gained > 0.3 > weight and not seen.grows:
            step, weight = found, 0.6 + 0.35 * gained
    if step:
        evidence = f"the torque moves in steps of {step:.3g} {effort}, and swings by {seen.swing:.3g} {effort}"
        yield seen.cause("torque step", weight, evidence, key, value)


def _loop(seen: Seen) -> Iterator[Cause]:
    """Test the declared loop, then the one with the delay that the log shows."""
    loop, known = seen.loop, seen.known
    if loop is None:
        return
    largest = largest_stable_damping(round(known.delay), loop.mass, loop.period)
    by_damping, limit = loop.damping / largest, 0.0
    softer = replace(loop, stiffness=1e-6 * loop.stiffness)
    if loop.grows:
        is_damping = softer.grows or by_damping > 0.9
        weight = 0.9 if seen.buzz.chatter or seen.buzz.purity > 0.3 else 0.6
        if is_damping:
            text = f"damping is {by_damping:.2f} times the largest stable at this delay; {seen.line}"
            least = float(f"{0.25 * largest:.3g}")
            yield seen.cause("damping above its limit", weight, text, f"{known.wall}.damping", least)
        else:
            limit = (loop.lost + loop.damping) / (loop.period * (loop.delay + 0.5))
            text = f"stiffness is {loop.stiffness / max(limit, 1e-12):.3g} times the stable one; {seen.line}"
            yield seen.cause("stiffness above its limit", weight, text, *seen.wall(loop))
    if seen.late:
        later = replace(loop, delay=loop.delay + seen.late)
        mode = later.slowest()
        weight = (0.95 if mode.growth > 0.0 else 0.6) if seen.skipped < 0.02 else 0.3
        grows = "grows" if mode.growth > 0.0 else "decays"
        text = f"torques act {seen.late:.2g} holds later than declared; with them the loop {grows} at "
        text = f"{text}{mode.frequency:.3g} Hz; {seen.line}"
        yield seen.cause("delay or late frames", weight, text, *(known.late_by or seen.wall(later)))


def _lost(seen: Seen) -> Iterator[Cause]:
    if seen.motion.lost > 0.01:
        later = seen.loop and replace(seen.loop, delay=seen.loop.delay + 1.0)
        weight = (0.93 if later is None or later.grows else 0.85) if not seen.grows else 0.5
        text = f"{100.0 * seen.motion.lost:.3g} % of the positions did not come in time, and the torque before was held"
        remedy = seen.known.late_by or seen.wall(later)
        yield seen.cause("delay or late frames", weight, f"{text}; {seen.line}", *remedy)


def _skipped(seen: Seen) -> Iterator[Cause]:
    gaps = seen.motion.gaps
    if gaps is None or not (gaps > 1).any():
        return
    share, longest = seen.skipped, float(np.quantile(gaps[gaps > 1], 0.9))
    later = seen.loop and replace(seen.loop, delay=seen.loop.delay + longest)
    weight = (0.94 if later is None or later.grows else 0.85) if share > 0.02 else 0.4
    text = f"{100.0 * share:.3g} % of the SYNCs were skipped, one torque held for {longest:.0f} sample times"
    yield seen.cause("skipped SYNCs", weight, text, *(seen.known.skipped_by or seen.wall(later)))


def _current_loop(seen: Seen) -> Iterator[Cause]:
    known, lag, gained = seen.known, 0.0, 0.0
    if "current_loop" in known.effects:
        lag = known.effects["current_loop"][1].time_constant / known.period
        gained = 0.5
    else:
        lag, gained = _best(seen, [0.5, 1.0, 2.0, 4.0, 8.0], _lagged)
    if lag < 0.3 or gained < 0.4:
        return
    later = seen.loop and replace(seen.loop, delay=seen.loop.delay + lag)
    weight = 0.93 if later is None or (later.grows and not seen.grows) else 0.7 if later.grows else 0.3
    text = f"the motor answers its demand with a lag of {lag * known.period * 1e3:.3g} ms (0x60F6)"
    yield seen.cause("resonance or lag of the drive (0x60F6)", weight, f"{text}; {seen.line}", *seen.wall(later))


def _shaft(seen: Seen) -> Iterator[Cause]:
    known, omega = seen.known, 2.0 * pi * seen.buzz.frequency
    moved = abs(seen.buzz.impedance) / omega**2  # mass that would move so
    weight, text = 0.0, ""
    if "shaft_compliance" in known.effects and known.mass:
        shaft = known.effects["shaft_compliance"][1]
        motor = known.mass - shaft.load_mass
        resonance = float(np.sqrt(shaft.stiffness * (1.0 / motor + 1.0 / shaft.load_mass))) / (2.0 * pi)
        weight = 0.95 if not seen.grows or 0.5 < seen.buzz.frequency / resonance < 1.6 else 0.5
        text = f"the shaft resonates at {resonance:.3g} Hz"
    elif known.mass and seen.buzz.purity > 0.5 and seen.buzz.frequency > 15.0 and moved < 0.4 * known.mass:
        weight = (0.92 if seen.buzz.phase < 0.2 else 0.5) if seen.buzz.torque > seen.motion.felt else 0.0
        text = "no rigid mass moves so: a shaft or a belt"
    if weight and known.mass:
        text += f"; the handle moves at {seen.buzz.frequency:.3g} Hz like {moved:.3g} of {known.mass:.3g} declared"
        key, value = _less(seen, omega)
        yield seen.cause("compliant shaft", weight, text, key, value)


def _less(seen: Seen, omega: float) -> tuple[str, float | str | None]:
    """Return a tenth of what drives a resonance: of the damper where it is the larger part of the torque there."""
    known = seen.known
    key = "damping" if known.damping * omega > (known.stiffness or 0.0) else "stiffness"
    value = known.damping if key == "damping" else known.stiffness
    return f"{known.wall}.{key}", None if value is None else float(f"{0.1 * value:.3g}")


def _stick_slip(seen: Seen) -> Iterator[Cause]:
    known, motion, buzz = seen.known, seen.motion, seen.buzz
    span = max(1, round(0.005 / motion.period))
    speeds = np.abs(motion.position[span:] - motion.position[:-span])[
        buzz.windows[:, None] + np.arange(buzz.size - span)
    ]
    resting = float((speeds < 0.1 * np.sqrt((speeds**2).mean()) + 1.1 * motion.count).mean())
    dry = next((of for name, of in known.effects.items() if name in ("stribeck_friction", "coulomb_friction")), None)
    weight = 0.5 + min(0.45, 0.9 * resting) if dry is not None or resting > 0.3 else 0.9 * resting
    if dry is None and np.sqrt((speeds**2).mean()) < 3.0 * motion.count:
        return
    if seen.grows or buzz.share > 0.5 or buzz.frequency > 40.0 or (dry is None and buzz.torque > motion.felt):
        weight *= 0.4
    key, value = f"axes.{known.place}.passivity.device_friction", None
    if dry is not None and dry[1].static > dry[1].kinetic:
        key, value = f"{known.effects_at}.{dry[0]}.static", dry[1].kinetic
    elif dry is None and resting < 0.15:
        return
    text = f"the handle rests in {100.0 * resting:.0f} % of the time and slips between"
    yield seen.cause("stick-slip of dry friction", weight, text, key, value)


def _saturation(seen: Seen) -> Iterator[Cause]:
    known, command = seen.known, seen.motion.command
    if command is None:
        return
    limit, key = known.limit, f"axes.{known.place}.torque_limit"
    if "torque_saturation" in known.effects:
        place, parameters = known.effects["torque_saturation"]
        if parameters.limit < limit:
            limit, key = parameters.limit, f"{known.effects_at}.{place}.limit"
    asked = np.abs(command[seen.buzz.windows[:, None] + np.arange(seen.buzz.size)])
    cut = float((asked > 0.99 * limit).mean())
    if cut < 0.01:
        return
    text = f"the torque is at its limit of {limit:.3g} {effort_unit(known.unit)} in {100.0 * cut:.0f} % of the time"
    weight = min(0.55, 0.3 + cut) if seen.grows or seen.late else min(0.9, 0.6 + cut)
    yield seen.cause("saturated torque", weight, text, key, float(f"{1.5 * asked.max():.3g}"))


def _hand(seen: Seen) -> Iterator[Cause]:
    """Test whether the motion comes from the hand: the wall then takes energy out at its frequency."""
    known, buzz = seen.known, seen.buzz
    tremor = known.effects.get("tremor")
    takes = buzz.phase > 0.2 or not buzz.impedance
    if tremor is not None:
        near = abs(buzz.frequency / tremor[1].frequency - 1.0) < 0.25
        weight = 0.95 if near and not seen.grows else 0.6 if near else 0.2
    else:
        weight = (0.75 if takes and 3.0 < buzz.frequency < 15.0 and buzz.purity > 0.5 else _UNTESTED) * (
            0.4 if seen.grows else 1
        )
    key, value = f"{known.wall}.damping", None
    if tremor is not None:
        key, value = f"{known.effects_at}.{tremor[0]}.amplitude", 0.25 * tremor[1].amplitude
    does = "the wall takes energy out" if takes else "the wall does not take energy out"
    text = f"at {buzz.frequency:.3g} Hz {does}; a hand trembles at 4 to 12 Hz"
    yield seen.cause("a hand that trembles", weight, text, key, value)


def _second_rig(seen: Seen) -> Iterator[Cause]:
    known, buzz = seen.known, seen.buzz
    for name in known.coupled_to if known.coupled else ():
        other = seen.others.get(name)
        if other is not None:
            apart = abs(other.frequency / buzz.frequency - 1.0)
            text = f"{name} trembles too, at {other.frequency:.3g} Hz, through the coupling of both; {seen.line}"
            value = None if known.stiffness is None else float(f"{0.05 * known.stiffness:.3g}")
            yield seen.cause(
                "two rigs in a loop", 0.97 if apart < 0.5 else 0.92, text, f"{known.wall}.stiffness", value
            )
    if not known.coupled and buzz.phase > 0.25 and buzz.frequency > 15.0 and buzz.purity > 0.6 and not seen.grows:
        text = f"the wall takes energy out at {buzz.frequency:.3g} Hz: no hand, another rig or a motor moves the grip"
        yield seen.cause("two rigs in a loop", 0.65, text, f"{known.wall}.stiffness", seen.wall(seen.loop)[1])


TESTS: Final = (
    _encoder, _torque_step, _loop, _lost, _skipped, _current_loop, _shaft, _stick_slip, _saturation, _hand, _second_rig,
)  # fmt: skip
"""Tests of the causes; each yields those for which the log says something."""

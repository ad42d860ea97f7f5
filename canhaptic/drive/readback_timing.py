"""Finds out whether a drive reports its torque just before or just after the update at a SYNC.

With a synchronous RPDO the torque c[k], sent in answer to SYNC k, acts from SYNC k+1 on. A TPDO of SYNC k therefore
shows c[k-2] when the drive samples before the update (the hold that ended) and c[k-1] when it samples after it (the
hold that begins). With an event-driven RPDO nothing is updated at SYNC: either kind of drive shows c[k-1], the hold
that ended.

A torque that changes at every SYNC shows which one applies. The answer goes into `demand_reported` of the axis;
with the wrong value the energy of every hold is computed with the torque of its neighbour.
"""

from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

from canhaptic.drive.rig import Rig
from canhaptic.errors import ParameterError

Reported = Literal["before", "after"]

_CLEAR: Final = 0.25  # of the changes of torque: the right alignment must explain all but this part of them
_LEAST_CHANGES: Final = 8
_LEAST_COUNTS: Final = 3  # amplitude of the probe in counts of 0x6071, so that rounding does not hide it


class ReadBackTiming(NamedTuple):
    """Timing of the read-back of one drive."""

    reported: Reported | None  # the value for `demand_reported`; None when it cannot be decided
    before_error: float  # mean |reported - expected|, as part of the mean change of torque; 0 fits exactly
    after_error: float
    changes: int  # SYNCs that could tell
    text: str


def detect_read_back(
    commanded: Sequence[int], reported: Sequence[int | None], rpdo: Literal["synchronous", "event"]
) -> ReadBackTiming:
    """Return when a drive samples the torque that it reports.

    Args:
        commanded: Target torque (0x6071) sent in answer to SYNC k, for each k.
        reported: Torque (0x6074 or 0x6077) in the TPDO of SYNC k; None where none arrived.
        rpdo: Time at which a torque acts, as in `bus.rpdo`.
    """
    before = after = change = 0.0
    changes = 0
    for k in range(2, min(len(commanded), len(reported))):
        seen, older, newer = reported[k], commanded[k - 2], commanded[k - 1]
        if seen is not None and older != newer:
            before += abs(seen - older)
            after += abs(seen - newer)
            change += abs(newer - older)
            changes += 1
    if changes < _LEAST_CHANGES:
        text = f"got {changes} changes of torque with an answer, expected at least {_LEAST_CHANGES}; probe longer"
        return ReadBackTiming(None, 0.0, 0.0, changes, text)
    before, after = before / change, after / change
    return ReadBackTiming(*_judged(before, after, rpdo), changes, _text(before, after, rpdo))


def _judged(before: float, after: float, rpdo: str) -> tuple[Reported | None, float, float]:
    """Return the alignment that explains the torques, and both errors."""
    if after <= _CLEAR:
        return ("after" if rpdo == "synchronous" else "before"), before, after
    return "before" if before <= _CLEAR and rpdo == "synchronous" else None, before, after


def _text(before: float, after: float, rpdo: str) -> str:
    seen = f"error {before:.3g} of the changes against the torque two SYNCs old, {after:.3g} against the last"
    if min(before, after) > _CLEAR:
        remedy = "a larger probe or a lower rate may help, else ask the vendor"
        return f"{seen}, expected one at most {_CLEAR:g}; the torque is filtered, noisy or not followed: {remedy}"
    if rpdo == "synchronous":
        return seen
    is_last = "before and after are the same" if after <= _CLEAR else "the last is expected, the drive is one SYNC late"
    return f"{seen}; with an event-driven RPDO {is_last}"


def probe_torques(amplitude: float, cycles: int) -> list[float]:
    """Return torques [N*m or N] that change often and move the axis nowhere.

    Each pair is +a, -a or -a, +a, in an order that does not repeat within 126 cycles, so that no delay of the drive is
    mistaken for another and the momentum never exceeds a times two sample times.
    """
    torques: list[float] = []
    register = 0b1011
    while len(torques) < cycles:
        bit = (register & 0b110000).bit_count() & 1  # of x^6 + x^5 + 1: 63 steps until it repeats
        register = (register << 1 | bit) & 0x3F
        sign = 1.0 if bit else -1.0
        torques += [sign * amplitude, -sign * amplitude]
    return torques[:cycles]


def measure_read_back(rig: Rig, amplitude: float, cycles: int = 64) -> list[ReadBackTiming]:
    """Probe a rig that runs with a small alternating torque on every axis; return the timing of each.

    The rig stays enabled with its last torque at zero; the caller stops it.

    Args:
        rig: Started rig; no controller may write torques meanwhile.
        amplitude: Amplitude of the probe [N*m or N]; the limits of each axis still apply.
        cycles: Number of SYNCs to probe.

    Raises:
        ParameterError: The amplitude is too small to be seen, or an axis reads nothing back.
        RigError: As the cycle raises; the rig has stopped.
    """
    for drive in rig.drives:
        least = _LEAST_COUNTS * drive.scaling.torque_quantum
        if amplitude < least:
            expected = f"expected at least {least:g} ({_LEAST_COUNTS} counts of 0x6071)"
            raise ParameterError(f"{drive.axis.name}: amplitude: got {amplitude:g}, {expected}")
        if drive.map.read_back == "none":
            raise ParameterError(f"{drive.axis.name}: read_back is none, so there is no timing; map 0x6074 or 0x6077")
    commanded: list[list[int]] = [[] for _ in rig.drives]
    reported: list[list[int | None]] = [[] for _ in rig.drives]
    for torque in [*probe_torques(amplitude, cycles), 0.0]:
        rig.sync()
        rig.write_torques([torque] * len(rig.drives))
        for axis, drive in enumerate(rig.drives):
            reported[axis].append(drive.reported_per_mille if drive.is_complete else None)
            commanded[axis].append(rig.records[-1].torques_per_mille[axis])
    return [detect_read_back(c, r, rig.bus.rpdo) for c, r in zip(commanded, reported, strict=True)]

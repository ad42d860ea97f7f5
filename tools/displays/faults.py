"""What an admittance display gives out when something fails, over CAN: energy, speed, and the time to standstill."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, cast

from canhaptic.cycle import run
from canhaptic.errors import CanHapticError, StartError
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.sim.plant.velocity_drive import VelocityDrivenPlant

SCENE = Path(__file__).resolve().parents[2] / "configs" / "admittance" / "virtual_mass.yaml"
_BEGIN = 0.8  # [s] of every fault
_START = 0.05  # [s] that a start may take: faults of the bus are timed from its first frame, those of the sensor later
_SENSOR = "simulation.admittance.sensor"
_WINDOW = f"during: [{{begin: {_BEGIN}, duration: 5}}]"
_WATCHED = "axes.0.admittance.force.frozen_after=50"
_FRICTION = ("passivity.drive_friction=0.5", "passivity.drive_damping=2.2")
"""Over-estimates of what the scene simulates: none, and 2 N*s/m."""

FAULTS: dict[str, tuple[str, ...]] = {
    "none": (),
    "sensor frozen": (f"{_SENSOR}.freeze_at={_BEGIN}", _WATCHED),
    "sensor frozen, not watched": (f"{_SENSOR}.freeze_at={_BEGIN}",),
    "sensor 5 N off": (f"{_SENSOR}.fault_at={_BEGIN}", f"{_SENSOR}.fault_offset=5"),
    "sensor 5 N off, friction declared": (f"{_SENSOR}.fault_at={_BEGIN}", f"{_SENSOR}.fault_offset=5", *_FRICTION),
    "sensor frozen, friction declared": (f"{_SENSOR}.freeze_at={_BEGIN}", *_FRICTION),
    "sensor 5 N off from the start": (f"{_SENSOR}.offset=5",),
    "sensor with the wrong sign": (f"{_SENSOR}.gain=-1",),
    "force one sample later than declared": (f"{_SENSOR}.latency=1",),
    "ramp of 3 m/s^2 left in the drive": ("simulation.drive.display.ramp=3",),
    "every RPDO lost": (f"simulation.bus={{drop: 1.0, direction: to_drive, ids: [0x201], {_WINDOW}}}",),
    "every TPDO lost": (f"simulation.bus={{drop: 1.0, direction: to_master, ids: [0x181], {_WINDOW}}}",),
    "TPDOs lost, one in ten": (f"simulation.bus={{drop: 0.1, direction: to_master, ids: [0x181], {_WINDOW}}}",),
    "master stalled for 0.3 s": (f"simulation.bus={{stall: [{{begin: {_BEGIN}, duration: 0.3}}]}}",),
    "bus silent": (f"simulation.bus={{drop: 1.0, {_WINDOW}}}",),
}


@dataclass
class FaultOutcome:
    """What one fault came to."""

    fault: str
    stopped_by: str  # reason of the stop; empty where the run went on
    stop: float  # time from the fault to the stop of the rig, less the time of the start for faults of the bus [s]
    still: float  # time from the stop of the rig to standstill [s]; -1 where it moved for longer than 2 s
    given: float  # largest fall of the true energy through the sensor after the fault [J]
    by_fault: float  # largest lag of that energy behind the run without the fault, until the stop [J]
    fastest: float  # after the fault [m/s]


@cache
def _energies_without_fault(cycles: int) -> tuple[float, ...]:
    """Returns the true energy through the sensor after every cycle of a run without a fault [J]."""
    found: list[float] = []
    with build(load_scene(SCENE), "free") as experiment:
        plant = cast(VelocityDrivenPlant, experiment.plants[0])
        run(experiment.cycle, cycles, progress=lambda _: found.append(-plant.energy().motor))
    return tuple(found)


def outcome(fault: str, cycles: int = 2000) -> FaultOutcome:
    """Returns what a fault of `FAULTS` came to."""
    return outcome_of(fault, FAULTS[fault], cycles)


def outcome_of(fault: str, changes: Sequence[str], cycles: int) -> FaultOutcome:
    """Returns what the changes of a fault came to; see `outcome`."""
    scene, healthy = load_scene(SCENE, changes), _energies_without_fault(cycles)
    period, most, reason, behind = scene.bus.sample_time, [-1e9, 0.0, 0.0], "", [0.0]
    with build(scene, "free") as experiment:
        plant = cast(VelocityDrivenPlant, experiment.plants[0])

        def watch(done: int) -> None:
            energy = -plant.energy().motor
            behind.append(healthy[done - 1] - energy)
            if done * period >= _BEGIN - _START:
                most[0] = max(most[0], energy)
                most[1] = max(most[1], most[0] - energy)
                most[2] = max(most[2], abs(plant.velocity))

        try:
            run(experiment.cycle, cycles, progress=watch)
        except CanHapticError as error:
            reason = "START_REFUSED" if isinstance(error, StartError) else experiment.rig.stop_reason.name
        drives: Any = experiment.far_side
        stopped, still = experiment.cycle.cycles * period, _standstill(plant, drives, experiment.clock)
        by_fault = max(behind)
        watch(cycles)
    return FaultOutcome(fault, reason, stopped - _BEGIN if reason else 0.0, still, most[1], by_fault, most[2])


def worst_offset(offset: float, times: int = 10) -> tuple[FaultOutcome, int]:
    """Returns the worst of runs in which the sensor is off from many times on, either way; and how many were not found.

    Args:
        offset: Of the sensor, with the friction of the drive declared [N].
        times: At which the offset comes, over one swing of the hand.
    """
    found = []
    for k in range(times):
        for sign in (-1.0, 1.0):
            changes = (f"{_SENSOR}.fault_at={0.3 + 0.14 * k}", f"{_SENSOR}.fault_offset={sign * offset}", *_FRICTION)
            found.append(outcome_of("sensor off", changes, 2600))
    return max(found, key=lambda one: one.by_fault), sum(not one.stopped_by for one in found)


def _standstill(plant: VelocityDrivenPlant, drives: Any, clock: Any) -> float:
    """Returns how long the handle moves on [s] after the master has left; -1 where that is more than 2 s."""
    begin = clock.now()
    for step in range(200):
        if abs(plant.velocity) < 5e-3 and step:
            return (step - 1) * 0.01
        clock.wait_until(begin + (step + 1) * 10_000_000)
        drives.process(clock.now())
        plant.advance_to(clock.now(), 0.0)
    return -1.0

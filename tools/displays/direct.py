"""One admittance display in a loop of floats: the plant of the package, a controller, delays and losses.

Slew and acceleration are watched inside the holds, so that a run tells whether what is declared of them is true.
"""

from dataclasses import dataclass, field
from random import Random
from typing import Any

from canhaptic.control.admittance import build_display_controller
from canhaptic.control.admittance.admittance_environment import AdmittanceEnvironment
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.balance import Branch, Certificate
from canhaptic.control.motion_checks import MassFelt
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import UserParameters
from canhaptic.sim.plant.velocity_drive import AdmittanceSimulation, VelocityDrivenPlant
from canhaptic.units import Parameters

_NONE, _HELD = Certificate.NONE.value, Branch.HELD.value
_DECLARED = Certificate.DECLARED_HAND.value
_CUTS = (Certificate.VELOCITY_LOOP.value, Certificate.LARGEST_HAND_FORCE.value, _DECLARED)
_IMPULSE = 1e-6  # one count of a running impulse [N*s]
_PARTS = 8
"""Parts of a hold in which slew and acceleration are watched; a power of two."""
_Motion = tuple[float, float, float]


@dataclass(frozen=True)
class Display:
    """A rig, its hand, and what is declared and asked of it."""

    plant: PlantParameters
    simulation: AdmittanceSimulation
    user: UserParameters | None
    environment: AdmittanceEnvironment
    properties: AdmittanceProperties
    algorithm: str
    parameters: Parameters | None = None
    effects: tuple[Effect, ...] = ()
    seed: int = 0
    samples_lost: float = 0.0  # part of the TPDOs
    commands_lost: int = 0  # RPDOs in a row, at most; three in ten begin such a row
    late: int = 0  # holds by which commands act later than declared: 0 unless a judge is judged

    @property
    def allowance(self) -> float:
        """Energy that may be given out [J]."""
        return float(getattr(self.parameters, "energy_allowance", 0.0))


@dataclass
class Outcome:
    """What one run came to; energies in [J]."""

    least: float = 0.0  # true sum through the sensor
    last: float = 0.0
    believed: float = 0.0
    least_believed: float = 0.0
    overclaimed: float = 0.0  # believed above true, at most
    underclaimed: float = 0.0  # true above believed and resolution together, at most
    doubt: float = 0.0
    cut: int = 0  # holds in which the certificate was active
    moving: int = 0  # holds with a command
    uncertified: int = 0
    travel: float = 0.0  # [m]
    slew: float = 0.0  # largest seen [N/s]
    acceleration: float = 0.0  # largest seen [m/s^2]
    bend: float = 0.0  # largest change of the slew seen inside a hold [N/s^2]
    speed: float = 0.0  # largest seen [m/s]
    force: float = 0.0  # largest seen [N]
    far_speed: float = 0.0  # largest seen behind the grip [m/s]
    by_declared: int = 0  # holds whose command rests on a hand declared as spring, damper and mass
    forces: list[float] = field(default_factory=list)  # true, at each SYNC [N]
    velocities: list[float] = field(default_factory=list)  # true, at each SYNC [m/s]

    @property
    def is_passive(self) -> bool:
        """Whether the account says that the port was passive."""
        return self.least_believed >= -1e-6


def run(display: Display, cycles: int, *, keeps: bool = False, felt: MassFelt | None = None) -> Outcome:
    """Returns what so many SYNCs came to.

    Args:
        display: What runs.
        cycles: How many.
        keeps: Whether forces and velocities are kept.
        felt: Estimator of the mass felt, which takes every sample that comes.
    """
    properties, period = display.properties, round(display.properties.sample_time * 1e9)
    plant = VelocityDrivenPlant(display.plant, display.simulation, display.user, display.effects, period, display.seed)
    controller: Any = build_display_controller(display.environment, display.algorithm, display.parameters, properties)
    random, found = Random(display.seed), Outcome()
    queue, acting, row, count = [0.0] * (properties.delay + display.late), 0.0, 0, properties.encoder_count
    plant.begin(0)
    times = sync_times(display, cycles)
    before, heard = (plant.force, plant.velocity, plant.position), (0, 0.0)
    for k in range(cycles):
        if k:
            command = queue.pop(0)
            if row < display.commands_lost and random.random() < 0.3:
                row += 1
            else:
                row, acting = 0, command
            begin, length = times[k - 1], times[k] - times[k - 1]
            slope: float | None = None
            for part in range(1, _PARTS + 1):
                plant.advance_to(begin + part * length // _PARTS, acting)
                force, step = before[0], length * 1e-9 / _PARTS
                before = watch(found, plant, before, step)
                risen, slope = slope, (before[0] - force) / step
                found.bend = found.bend if risen is None else max(found.bend, abs(slope - risen) / step)
        shown = plant.read_force()
        position = plant.encoder_position
        if count:
            position = round(position / count) * count
        lost = k > 3 and random.random() < display.samples_lost
        if properties.sampling == "impulse" and not lost:
            counts = round(shown / _IMPULSE) * _IMPULSE
            shown = (counts - heard[1]) / ((k - heard[0]) * properties.sample_time) if k else 0.0
            heard = k, counts
        if felt is not None and not lost:
            felt.take(position, -shown, k)
        balance = controller.sample_lost() if lost else controller.step(position, -shown)
        queue.append(balance.torque)
        _take(found, plant, balance, properties)
        if properties.latency == 0 and balance.branch != _HELD:
            most = found.believed + controller.energy_resolution
            found.underclaimed = max(found.underclaimed, found.last - most)
        if keeps:
            found.forces.append(plant.force)
            found.velocities.append(plant.velocity)
    found.doubt = controller.energy_resolution
    return found


def sync_times(display: Display, cycles: int) -> list[int]:
    """Returns the times of the SYNCs [ns], each up to half the jitter declared early or late, in parts of 64 ns."""
    period, random = round(display.properties.sample_time * 1e9), Random(display.seed + 1)
    reach = 0.5 * display.properties.jitter * period
    return [k * period + (64 * round(random.uniform(-reach, reach) / 64.0) if k else 0) for k in range(cycles)]


def watch(found: Outcome, plant: VelocityDrivenPlant, before: _Motion, time: float) -> _Motion:
    """Takes the largest slew, acceleration and speed within a part of a hold; returns what it is now."""
    force, velocity, position = plant.force, plant.velocity, plant.position
    found.slew = max(found.slew, abs(force - before[0]) / time)
    found.acceleration = max(found.acceleration, abs(velocity - before[1]) / time)
    found.speed, found.force = max(found.speed, abs(velocity)), max(found.force, abs(force))
    found.far_speed = max(found.far_speed, abs(plant.state[plant.state_names.index("load_velocity")]))
    found.travel += abs(position - before[2])
    return force, velocity, position


def _take(found: Outcome, plant: VelocityDrivenPlant, balance: Any, properties: AdmittanceProperties) -> None:
    found.last = true = -plant.energy().motor
    found.believed += balance.h_i
    found.least = min(found.least, true)
    found.least_believed = min(found.least_believed, found.believed)
    if properties.latency == 0 and balance.branch != _HELD:  # a lost sample leaves its hold open until the next
        found.overclaimed = max(found.overclaimed, found.believed - true)
    if abs(balance.torque) > 1e-9 or balance.certificate in _CUTS:
        found.moving += 1
        found.cut += balance.certificate in _CUTS
    found.by_declared += balance.certificate == _DECLARED
    found.uncertified += balance.certificate == _NONE

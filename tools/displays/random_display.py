"""Random admittance displays, all declarations true: rigs, sensors with errors, hands, masses, algorithms."""

import math
from dataclasses import replace
from random import Random
from typing import Any

from canhaptic.control.admittance import DISPLAY_ALGORITHMS
from canhaptic.control.admittance.admittance_environment import AdmittanceEnvironment, AdmittanceMass
from canhaptic.control.admittance.cup_and_ball import CupAndBall
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from canhaptic.sim.plant.velocity_drive import (
    AdmittanceSimulation,
    GripParameters,
    SimulatedForceSensor,
    VelocityLoopParameters,
)
from tests.plant.read_effect import read_effect
from tools.displays.direct import Display, Outcome, run

_DURATION = 2.0  # for the drift [s]
_STATIC = 4.0  # static friction of the device [N]


def random_display(seed: int, algorithm: str | None = None) -> Display:
    """Returns the display of a seed, with slew and acceleration declared at random; see `with_true_bounds`."""
    random = Random(seed)
    time = random.choice([1e-3, 2e-3, 4e-3])
    mass, bandwidth = random.uniform(0.5, 3.0), random.choice([25.0, 50.0, 100.0])
    gain = 2.0 * math.pi * bandwidth * mass
    integral = random.choice([0.0, 0.0, 0.0, gain * 20.0, gain * 60.0])
    sensor, error = _sensor(random)
    grip = GripParameters(
        mass=random.choice([0.05, 0.3, 1.0]), stiffness=random.choice([2e3, 1e4, 5e4]),
        damping=random.choice([1.0, 5.0, 20.0]),
    )  # fmt: skip
    loop = VelocityLoopParameters(gain=gain, integral_gain=integral, torque_limit=random.choice([None, 500.0]))
    losses = 0 if integral else random.choice([0, 0, 1, 2])
    jitter = random.choice([0.0, 0.0, 0.0, 0.05])
    properties = AdmittanceProperties(
        sample_time=time, delay=random.choice([0, 1, 1, 2]), sampling=sensor.sampling,
        latency=sensor.latency, filter=sensor.filter, force_slew=2e4, handle_acceleration=200.0, force_error=error,
        encoder_count=random.choice([1e-7, 1e-6, 1e-5]), jitter=jitter, speed_quantum=1e-6,
        speed_limit=2.0, acceleration_limit=200.0, torque_limit=500.0,
    )  # fmt: skip
    name = algorithm or random.choice(["guarded", "guarded", "guarded", *DISPLAY_ALGORITHMS])
    guarded = GuardedAdmittanceParameters(
        drive_mass=mass * random.uniform(1.0, 1.1), loop_gain=gain * random.uniform(1.0, 1.1),
        integral_gain=integral * random.uniform(1.0, 1.1), spread=0.2,
        energy_allowance=random.choice([0.0, 1e-3, 1e-2]), max_consecutive_losses=losses,
        largest_hand_force=0.0 if integral else random.choice([0.0, 0.0, 30.0]),
    )  # fmt: skip
    display = Display(
        PlantParameters(mass=mass, damping=random.choice([0.0, 2.0, 10.0])),
        AdmittanceSimulation(loop=loop, grip=grip, sensor=sensor), _hand(random),
        _environment(random, name),
        properties, name, guarded if name == "guarded" else None, _effects(random), seed,
        random.choice([0.0, 0.0, 0.02]), losses,
    )  # fmt: skip
    is_declared = name == "guarded" and not integral and random.random() < 0.4
    return _with_declared_hand(display, guarded, random) if is_declared else display


def _with_declared_hand(display: Display, guarded: GuardedAdmittanceParameters, random: Random) -> Display:
    """Returns a display with a softer grip, which is declared; its far side and the friction as a run shows them.

    Without jitter, lost commands and another declaration of the hand.
    """
    grip = display.simulation.grip.model_copy(
        update={"stiffness": random.choice([300.0, 1000.0, 3000.0]), "damping": random.choice([0.0, 1.0])}
    )
    declared = {
        "hand_stiffness": grip.stiffness * random.uniform(1.0, 1.2), "hand_speed": 0.1,
        "hand_damping": grip.damping * random.uniform(1.0, 1.5),
        "drive_friction": _STATIC if display.effects else 0.0, "drive_damping": display.plant.damping,
        "largest_hand_force": 0.0, "max_consecutive_losses": 0,
    }  # fmt: skip
    return replace(
        display, commands_lost=0, properties=display.properties.model_copy(update={"jitter": 0.0}),
        simulation=display.simulation.model_copy(update={"grip": grip}),
        parameters=guarded.model_copy(update=declared),
    )  # fmt: skip


def with_true_bounds(display: Display, cycles: int, *, keeps: bool = False) -> tuple[Display, Outcome] | None:
    """Returns a display whose declared slew and acceleration hold, with its run; None where none was found.

    They are what a run shows and half as much again; the next run must then stay within.
    """
    for _ in range(3):
        found = run(display, cycles, keeps=keeps)
        properties = display.properties
        is_hand_true = 0.0 in (_hand_force(display), found.force) or found.force <= _hand_force(display)
        is_hand_true = is_hand_true and _is_declared_hand_true(display, found)
        if (
            found.slew <= properties.force_slew
            and found.acceleration <= properties.handle_acceleration
            and (not _has_corner(display) or found.bend <= properties.force_bend)
            and is_hand_true
        ):
            return display, found
        bounds = {"force_slew": 1.5 * found.slew, "handle_acceleration": 1.5 * found.acceleration}
        bounds |= {"force_bend": 1.5 * found.bend} if _has_corner(display) else {}
        display = replace(display, properties=properties.model_copy(update=bounds))
        if _hand_force(display) and display.parameters is not None:
            force = {"largest_hand_force": 1.5 * found.force}
            display = replace(display, parameters=display.parameters.model_copy(update=force))
        if _has_declared_hand(display) and display.parameters is not None:
            hand = {"hand_speed": 1.5 * found.far_speed}
            display = replace(display, parameters=display.parameters.model_copy(update=hand))
    return None


def _has_corner(display: Display) -> bool:
    """Returns whether the bend of the force between two samples is declared: every other time with points."""
    return display.properties.sampling == "point" and display.seed % 2 == 1


def _has_declared_hand(display: Display) -> bool:
    return bool(getattr(display.parameters, "hand_stiffness", 0.0))


def _is_declared_hand_true(display: Display, found: Outcome) -> bool:
    known = display.parameters
    if not _has_declared_hand(display) or not isinstance(known, GuardedAdmittanceParameters):
        return True
    return found.far_speed <= known.hand_speed


def _hand_force(display: Display) -> float:
    """Returns the largest force of the hand that is declared; 0: none [N]."""
    return float(getattr(display.parameters, "largest_hand_force", 0.0))


def _sensor(random: Random) -> tuple[SimulatedForceSensor, float]:
    """Returns a sensor and the largest error of one of its values [N]."""
    noise, offset = random.choice([0.0, 0.02, 0.1]), random.choice([0.0, 0.0, 0.05, 0.3])
    quantum, drift = random.choice([0.0, 0.01, 0.1]), random.choice([0.0, 0.0, 0.02])
    sampling: Any = random.choice(["point", "point", "mean", "impulse"])
    quantum = 0.0 if sampling == "impulse" else quantum
    corner = random.choice([0.0, 0.0, 200.0]) if sampling == "point" else 0.0
    sensor = SimulatedForceSensor(
        sampling=sampling, filter=corner, offset=random.choice([-1.0, 1.0]) * offset, drift=drift, noise=noise,
        quantum=quantum, latency=random.choice([0, 0, 0, 1, 2]),
    )  # fmt: skip
    counted = 2e-3 if sampling == "impulse" else 0.0  # two counts of 1e-6 N*s in 1 ms
    return sensor, offset + drift * _DURATION + 3.0 * noise + 0.5 * quantum + counted


def _environment(random: Random, algorithm: str) -> AdmittanceEnvironment:
    lower_wall, damping = random.choice([-10.0, -0.03]), random.choice([0.0, 2.0, 10.0])
    if algorithm != "internal_dissipation" and random.random() < 0.2:
        return CupAndBall(
            cup=random.choice([0.2, 2.4]), ball=random.choice([0.1, 0.6, 2.0]), length=random.choice([0.05, 0.45]),
            damping=damping, lower_wall=lower_wall,
        )  # fmt: skip
    return AdmittanceMass(
        mass=random.choice([0.1, 0.5, 1.0, 2.0, 5.0]), damping=damping, stiffness=random.choice([0.0, 0.0, 200.0]),
        lower_wall=lower_wall,
    )  # fmt: skip


def _hand(random: Random) -> UserParameters:
    motion = SinusoidMotion(
        amplitude=random.choice([0.01, 0.05, 0.1]), frequency=random.uniform(0.5, 6.0), phase=random.uniform(-3.0, 3.0)
    )
    return UserParameters(
        stiffness=random.choice([50.0, 300.0, 2000.0]), damping=random.choice([0.5, 5.0, 20.0]),
        push=random.choice([0.0, 0.0, 5.0]), motion=motion,
    )  # fmt: skip


def _effects(random: Random) -> tuple[Effect, ...]:
    """Returns friction of the device, or none."""
    if random.random() < 0.7:
        return ()
    return (read_effect({"type": "coulomb_friction", "kinetic": random.choice([0.5, 3.0]), "static": _STATIC}, "m"),)

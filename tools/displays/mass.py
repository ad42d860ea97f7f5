"""Is the mass that hands feel over a run the one that `check` promises? Random displays as people build them.

    python -m tools.displays.mass --runs 200

Rigs, sensors, masses and hands are random; slew, corner and acceleration are declared as a run shows them and half as
much again. The mass is the one that `run` prints (`MassFelt`), the range the one that `check` prints (`run_mass`).
"""

import argparse
import math
from random import Random
from typing import Any, NamedTuple

from canhaptic.control.admittance.admittance_environment import AdmittanceMass
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.control.motion_checks import MassAsked, MassFelt
from canhaptic.scene.hints import lag_of, run_mass
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from canhaptic.sim.plant.velocity_drive import (
    AdmittanceSimulation,
    GripParameters,
    SimulatedForceSensor,
    VelocityLoopParameters,
)
from tools.displays.direct import Display, run
from tools.displays.random_display import with_true_bounds

_SECONDS = 2.0
_LIGHTEST, _HEAVIEST = 0.3, 3.0
"""Masses asked, over the lightest that is passive without a guard."""


class Judged(NamedTuple):
    """What a display promises and what was felt on it [kg]."""

    asked: float
    least: float
    most: float
    felt: float | None

    @property
    def is_inside(self) -> bool:
        """Whether the mass felt is the one promised."""
        return self.felt is not None and self.least <= self.felt <= self.most


def display_of(seed: int) -> Display:
    """Returns the display of a seed."""
    random = Random(seed)
    time, moved = random.choice([1e-3, 2e-3, 4e-3]), random.uniform(0.5, 3.0)
    gain, noise = 2.0 * math.pi * random.choice([25.0, 50.0, 100.0]) * moved, random.choice([0.0, 0.02, 0.05])
    sampling: Any = random.choice(["mean", "mean", "point"])
    properties = AdmittanceProperties(
        sample_time=time, delay=random.choice([0, 1, 1]), sampling=sampling, latency=random.choice([0, 0, 1]),
        force_slew=200.0, handle_acceleration=20.0, force_error=3.0 * noise + 0.01, force_bend=1e3,
        encoder_count=random.choice([1e-6, 1e-5]), speed_quantum=1e-6, speed_limit=2.0, acceleration_limit=200.0,
        torque_limit=500.0,
    )  # fmt: skip
    known = GuardedAdmittanceParameters(
        drive_mass=1.05 * moved, loop_gain=1.05 * gain, spread=0.2, energy_allowance=random.choice([1e-3, 1e-2])
    )
    asked = (known.drive_mass + known.loop_gain * lag_of(properties)) * _LIGHTEST * 10.0 ** random.random()
    motion = SinusoidMotion(amplitude=random.choice([0.03, 0.05, 0.1]), frequency=random.uniform(0.5, 4.0))
    sensor = SimulatedForceSensor(sampling=sampling, noise=noise, latency=properties.latency)
    grip = GripParameters(mass=random.choice([0.1, 0.3]), stiffness=1e4, damping=20.0)
    return Display(
        PlantParameters(mass=moved, damping=random.choice([0.0, 2.0, 5.0])),
        AdmittanceSimulation(loop=VelocityLoopParameters(gain=gain), grip=grip, sensor=sensor),
        UserParameters(stiffness=random.choice([1e2, 3e2, 1e3]), damping=random.choice([5.0, 20.0]), motion=motion),
        AdmittanceMass(mass=asked, damping=random.choice([2.0, 5.0, 10.0])), properties, "guarded", known, (), seed,
    )  # fmt: skip


def judged(seed: int) -> Judged | None:
    """Returns what the display of a seed promises and what was felt on it; None where no true bounds were found."""
    found = with_true_bounds(display_of(seed), round(_SECONDS / display_of(seed).properties.sample_time))
    if found is None:
        return None
    display, properties = found[0], found[0].properties
    asked, known = getattr(display.environment, "mass", 0.0), display.parameters
    assert isinstance(known, GuardedAdmittanceParameters)
    felt = MassFelt(
        MassAsked(asked, 0.0, -1e9, 1e9, sample_time=properties.sample_time, count=properties.encoder_count)
    )
    run(display, round(_SECONDS / properties.sample_time), felt=felt)
    never = known.drive_mass + known.loop_gain * lag_of(properties)
    return Judged(asked, *run_mass(asked, never), felt.mass)


def main() -> None:
    """Prints what is outside, and how many are inside."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    found = {seed: judged(seed) for seed in range(parser.parse_args().runs)}
    for seed, one in found.items():
        if one is not None and not one.is_inside:
            print(f"{seed}: asked {one.asked:.3g} kg, promised {one.least:.3g} to {one.most:.3g}, felt {one.felt}")
    inside = sum(one is not None and one.is_inside for one in found.values())
    print(f"{inside} of {sum(one is not None for one in found.values())} inside, of {len(found)}")


if __name__ == "__main__":
    main()

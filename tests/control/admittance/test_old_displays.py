"""Every admittance algorithm without a certificate does to the last bit what it did in its form of before."""

import random
from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest

from canhaptic.control.admittance import DISPLAY_ALGORITHMS, build_display_controller
from canhaptic.control.admittance.cup_and_ball import CupAndBall
from canhaptic.control.admittance.group_environment import DisplayMass
from canhaptic.control.admittance.port import DisplayProperties
from canhaptic.registry import load
from tests.control.old_forms.table import OLD_DISPLAYS

CHOICES: dict[str, list[dict[str, Any]]] = {
    "energy_tank": [{}, {"initial": 1e-3, "capacity": 1e-2}, {"initial": 0.5, "capacity": 0.1}],
    "ultimately_passive": [{}, {"alpha": 1e3}, {"alpha": 1e6, "hand_stiffness": 100.0}],
}
ENVIRONMENTS = [
    DisplayMass(mass=0.5),
    DisplayMass(mass=0.02, damping=0.3, lower_wall=-2e-3, upper_wall=3e-3),
    DisplayMass(mass=0.4, damping=4.0, stiffness=500.0, rest=1e-3),
    CupAndBall(damping=1.0, upper_wall=4e-3),
]


class Drawn(NamedTuple):
    """One run at random."""

    environment: Any
    parameters: Any
    properties: DisplayProperties
    seed: int


def drawn(algorithm: str, seed: int) -> Drawn:
    """Returns what is rendered, the choices of an algorithm, and the loop."""
    rng = random.Random(f"{algorithm} {seed}")
    environments = ENVIRONMENTS[:3] if algorithm == "internal_dissipation" else ENVIRONMENTS
    chosen = rng.choice(CHOICES.get(algorithm, [{}]))
    properties = DisplayProperties(
        sample_time=rng.choice([1e-3, 2.5e-4]), delay=rng.choice([0, 1, 3]), latency=rng.choice([0, 1, 3]),
        sampling=rng.choice(["point", "mean", "impulse"]), filter=rng.choice([0.0, 200.0]), force_slew=2e3,
        handle_acceleration=50.0, force_error=rng.choice([0.0, 0.05]), encoder_count=rng.choice([0.0, 1e-6]),
        speed_quantum=rng.choice([0.0, 1e-4]), speed_limit=rng.choice([0.2, 5.0]),
        acceleration_limit=rng.choice([5.0, 1e3]), jitter=rng.choice([0.0, 0.01]),
    )  # fmt: skip
    parameters = load(DISPLAY_ALGORITHMS, algorithm, "admittance algorithm").parameters_type(**chosen)
    return Drawn(rng.choice(environments), parameters, properties, seed)


def answers(controller: Any, run: Drawn, steps: int) -> Iterator[Any]:
    """Yields what a controller answers under the force of a hand; samples are lost, SYNCs are skipped."""
    rng = random.Random(run.seed)
    losses, skips = rng.choice([0.0, 0.01, 0.2]), rng.choice([0.0, 0.01])
    position, velocity, force, pushed, time = 0.0, 0.0, 0.0, 0.0, run.properties.sample_time
    for _ in range(steps):
        if rng.random() < 0.05:
            pushed = rng.choice([0.0, rng.uniform(-8.0, 8.0), -500.0 * position])
        force += 0.3 * (pushed - force) + rng.choice([0.0, rng.gauss(0.0, 0.2)])
        if rng.random() < skips:
            skipped = rng.randint(1, 3)
            controller.lasted(1.0 + skipped)
            position += skipped * time * velocity
        position += time * velocity
        answer = controller.hold() if rng.random() < losses else controller.step(position, -force)
        velocity += rng.choice([0.2, 1.0]) * (answer.torque - velocity)
        yield answer, controller._axis.doubt


def require_equal(algorithm: str, runs: int, steps: int) -> None:
    moving = 0
    for seed in range(runs):
        run = drawn(algorithm, seed)
        old = OLD_DISPLAYS[algorithm](run.environment, run.parameters, run.properties)
        new = build_display_controller(run.environment, algorithm, run.parameters, run.properties)
        for place, (first, second) in enumerate(zip(answers(old, run, steps), answers(new, run, steps), strict=True)):
            assert repr(second) == repr(first), (algorithm, seed, place)
            moving += first[0].torque != 0.0
    assert moving > runs * steps // 10


@pytest.mark.parametrize("algorithm", OLD_DISPLAYS)
def test_an_admittance_algorithm_is_what_it_was(algorithm: str) -> None:
    require_equal(algorithm, runs=20, steps=120)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", OLD_DISPLAYS)
def test_an_admittance_algorithm_is_what_it_was_over_many_steps(algorithm: str) -> None:
    """100,000 steps of all of them."""
    require_equal(algorithm, runs=100, steps=200)

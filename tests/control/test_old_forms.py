"""Every sampled algorithm does to the last bit what it did in its form of before, interpreted and compiled."""

import random
from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import pytest

from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.control.environments.environment import plain, tuple_type
from canhaptic.control.passivity import ALGORITHMS, build_controller
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.kernels import Run, list_of_zeros
from canhaptic.kernels.records import arrays_of, records_of
from canhaptic.registry import load
from tests.control.cases import EXAMPLES
from tests.control.old_forms.table import OLD_FORMS

CHOICES: dict[str, list[dict[str, Any]]] = {
    "a_priori_dissipation": [{}, {"rearm": "displacement"}, {"alpha": "200 s/m^2"}],
    "internal_dissipation": [{}, {"alpha": "200 s/m^2"}],
    "passivity_observer": [{}, {"damping_limit": 20.0}],
    "adaptive_reference": [{}, {"damping_limit": 20.0, "least_speed": 0.0}],
    "windowed_observer": [{}, {"window": 3}, {"window": 1, "damping_limit": 9.0}],
    "bounded_observer": [{}, {"force_limit": 2.0}, {"speed_offset": 0.2, "integral_holds": 2.0}],
    "force_gradient": [{}, {"least_force": 0.3}],
    "force_augmentation": [{}, {"feedback_stiffness": 50.0, "coarse": 20.0, "increment": 0.05}],
    "energy_tank": [{}, {"constant_stiffness": 100.0, "initial_energy": 1e-3, "most_energy": 1e-2}],
    "ultimate_passivity": [{}, {"lower": -1e-4, "upper": 1e-4, "counted_holds": 50}, {"conservative_damping": 2.0}],
}


class Sample(NamedTuple):
    """What a controller is given at one SYNC."""

    is_lost: bool
    skipped: int  # SYNCs before it
    position: float
    scale: float  # of the torque that acts, over the one commanded


class Drawn(NamedTuple):
    """One run at random."""

    environment: Any
    parameters: Any
    loop: LoopProperties
    samples: list[Sample]


def drawn(algorithm: str, seed: int, steps: int) -> Drawn:
    """Returns a loop, the choices of an algorithm and the samples of a hand that goes in and out."""
    rng = random.Random(f"{algorithm} {seed}")
    environment, _ = EXAMPLES[rng.choice(list(EXAMPLES))]
    count = rng.choice([0.0, 1e-6, 1e-4])
    chosen = dict(rng.choice(CHOICES.get(algorithm, [{}])))
    if count and rng.random() < 0.5:
        chosen |= {"velocity": "windowed", "velocity_window": rng.choice([0.004, 0.02])}
    loop = LoopProperties(
        sample_time=rng.choice([1e-2, 1e-3, 1.25e-4]), delay=rng.choice([0, 1, 3]), moving_mass=0.25,
        device_damping=rng.choice([0.2, 30.0]), encoder_count=count, torque_quantum=rng.choice([0.0, 0.01]),
        torque_limit=rng.choice([None, 3.0]), torque_window=rng.choice([None, 5e-5]),
    )  # fmt: skip
    parameters = load(ALGORITHMS, algorithm, "passivity algorithm").parameters_type(**chosen)
    return Drawn(environment, parameters, loop, list(samples_of(rng, count, steps)))


def samples_of(rng: random.Random, count: float, steps: int) -> Iterator[Sample]:
    """Yields samples, now and then one that is lost, SYNCs that were skipped, and a hold at rest."""
    losses, skips = rng.choice([0.0, 0.01, 0.2, 0.2]), rng.choice([0.0, 0.01])
    position, speed = rng.uniform(-0.01, 0.01), 0.0
    for _ in range(steps):
        if rng.random() < 0.03:
            speed = rng.choice([0.0, rng.uniform(-3e-4, 3e-4), rng.uniform(-3e-3, 3e-3)])
        position += speed + rng.choice([0.0, 0.0, rng.gauss(0.0, 1e-5)])
        if abs(position) > 0.012:
            speed = -speed if speed * position > 0.0 else speed
        shown = round(position / count) * count if count else position
        skipped = rng.randint(1, 4) if rng.random() < skips else 0
        yield Sample(rng.random() < losses, skipped, shown, rng.choice([1.0, 1.0, 1.0, 0.5, 0.0, -0.3]))


def answers(controller: Any, run: Drawn) -> Iterator[Any]:
    """Yields what a controller answers to every SYNC; torques act after the delay of the loop, some only in part."""
    waiting = [0.0] * (run.loop.delay + 1)
    limit = run.loop.torque_limit or 1e9
    for sample in run.samples:
        if sample.skipped:
            controller.lasted(1.0 + sample.skipped)
        acting = min(max(waiting.pop(0), -limit), limit) * sample.scale
        answer = controller.hold() if sample.is_lost else controller.step(sample.position, acting)
        waiting.append(answer.torque)
        yield answer


def require_equal(algorithm: str, runs: int, steps: int) -> None:
    torques = 0
    for seed in range(runs):
        run = drawn(algorithm, seed, steps)
        old = OLD_FORMS[algorithm](plain(run.environment), run.parameters, run.loop)
        new = build_controller(run.environment, algorithm, run.parameters, run.loop)
        for place, (first, second) in enumerate(zip(answers(old, run), answers(new, run), strict=True)):
            assert repr(second) == repr(first), (algorithm, seed, place)
            torques += first.torque != 0.0
    assert torques > runs * steps // 10


@pytest.mark.parametrize("algorithm", OLD_FORMS)
def test_an_algorithm_is_what_it_was(algorithm: str) -> None:
    require_equal(algorithm, runs=60, steps=120)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", OLD_FORMS)
def test_an_algorithm_is_what_it_was_over_many_steps(algorithm: str) -> None:
    """420,000 steps of all of them."""
    require_equal(algorithm, runs=140, steps=250)


@cache
def compiled_step(step: Any) -> Any:
    from canhaptic.kernels.compiler import compiled  # numba is an extra

    return compiled(step)


class CompiledController:
    """The compiled step of an algorithm; of a sample that was lost it says the torque alone."""

    def __init__(self, algorithm: str, run: Drawn) -> None:
        environment, kernel = plain(run.environment), load(ALGORITHMS, algorithm, "passivity algorithm").kernel
        settings, kind = kernel.settings(environment, run.parameters, run.loop), tuple_type(environment)
        self._state, self._step, self._last = records_of([kernel.state()]), compiled_step(kernel.step), AT_REST
        run_of = Run(records_of([settings])[0], self._state[0], arrays_of(kernel.memory(settings, list_of_zeros)))
        self._fixed = kind(*(float(getattr(environment, name)) for name in kind._fields)), run_of

    def hold(self) -> EnergyBalance:
        self._state["axis"]["missed"] += self._state["axis"]["started"]
        return self._last

    def lasted(self, periods: float) -> None:
        self._state["axis"]["lasted"] += periods - 1.0

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        self._last = self._step(*self._fixed, position, torque_applied)
        return self._last


@pytest.mark.slow  # compiles every algorithm
@pytest.mark.timeout(600)
@pytest.mark.parametrize("algorithm", OLD_FORMS)
def test_a_compiled_algorithm_is_what_it_was(algorithm: str) -> None:
    """Over 12,000 steps of all of them."""
    pytest.importorskip("numba")
    environment, _ = EXAMPLES["spring_damper_wall"]
    torques = 0
    for seed in range(4):
        run = drawn(algorithm, seed, 300)._replace(environment=environment)
        old = OLD_FORMS[algorithm](plain(environment), run.parameters, run.loop)
        found = answers(CompiledController(algorithm, run), run)
        for sample, first, second in zip(run.samples, answers(old, run), found, strict=True):
            if not sample.is_lost:
                assert repr(tuple(second)) == repr(tuple(first)), seed
                torques += first.torque != 0.0
    assert torques > 100

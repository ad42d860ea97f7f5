"""A wall too stiff for its encoder gets softer and stays; on a plant with dry friction, judged by its energy."""

import math

import pytest

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import Guarded, GuardedParameters
from tools.attack.plant import TAKEN_IN, Rig, V, X, hold

T, MASS, FRICTION, COUNT, SUBSTEPS = 1e-3, 0.075, 0.04, 3e-5, 4
SUSTAINED = FRICTION / COUNT


def controller_of(stiffness: float, delay: int, count: float = COUNT) -> Guarded:
    loop = LoopProperties(
        sample_time=T, delay=delay, moving_mass=0.07, device_damping_bound=0.05, device_friction=FRICTION,
        device_friction_bound=0.0, torque_window=0.0, encoder_count=count, torque_limit=8.5,
    )  # fmt: skip
    return Guarded(SpringDamperWall(stiffness=stiffness, damping=0.0, position=0.0), GuardedParameters(), loop)


def leaning(controller: Guarded, stiffness: float, delay: int, seconds: int) -> tuple[list[float], float]:
    """Share of the wall rendered in each second, and the least sum of energy in and friction, of a hand with tremor."""
    rig, state, coming, torque = Rig(T / SUBSTEPS, MASS, 0.01, FRICTION), [0.0] * 8, [0.0] * delay, 0.0
    state[X], path, least, holds = 5e-3, 0.0, 0.0, round(1.0 / T)
    asked, sent = [0.0] * seconds, [0.0] * seconds
    for at in range(seconds * holds):
        position, time = COUNT * round(state[X] / COUNT), at * T
        coming.append(controller.step(position, torque).torque)
        torque = coming.pop(0)
        asked[at // holds] += min(8.5, stiffness * max(0.0, -position))
        sent[at // holds] += torque
        goal = -7e-3 + max(0.0, 0.012 - 0.02 * time) + 7e-4 * math.sin(6.0 * time) + 1e-4 * math.sin(57.0 * time)
        for _ in range(SUBSTEPS):
            before = state[X]
            hold(rig, state, torque, 200.0 * (goal - before) - 3.0 * state[V], rig.sample_time)
            path += abs(state[X] - before)
        least = min(least, state[TAKEN_IN] + FRICTION * path)
    return [one / whole for one, whole in zip(sent, asked, strict=True)], least


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("times", [0.9, 2.0, 7.5])
def test_a_wall_beyond_what_friction_pays_for_gets_as_soft_as_that_and_stays(times: float, delay: int) -> None:
    stiffness = times * SUSTAINED
    shares, least = leaning(controller_of(stiffness, delay), stiffness, delay, 4)
    assert min(shares[1:]) > 0.95 * min(1.0, 1.0 / times)
    assert max(shares[1:]) < 1.2 * min(1.0, 2.0 / times)
    assert least > -1e-9

"""The certificate of the velocity loop against the worst motion, found by a quadratic programme of its own."""

from dataclasses import replace

import numpy as np
import pytest

from canhaptic.control.admittance.admittance_environment import Commands
from canhaptic.control.admittance.velocity_loop import LoopState, VelocityLoop

_STEPS = 40  # of the motion in one hold


def _settings(gain: float, integral: float, *, delay: int = 1, losses: int = 0, time: float = 1e-3) -> VelocityLoop:
    return VelocityLoop(time, delay, losses, 2.0, gain, gain, integral, integral, 0.0, 1e9)


def _form(commands: list[float], gain: float, integral: float, lead: float, time: float) -> tuple:
    """Returns (quadratic, linear, constant) of the loss of W over the speeds of all steps: c (r - v) v + f_I r."""
    step = time / _STEPS
    r = np.repeat(commands, _STEPS)
    size = len(r)
    before = np.tril(np.ones((size, size)), -1) + 0.5 * np.eye(size)  # way to the middle of each step, per speed
    quadratic = -gain * step * np.eye(size)
    linear = gain * r * step - integral * step * step * (before.T @ r)
    constant = integral * lead * r.sum() * step + integral * step * step * (r @ (before @ r))
    return quadratic, linear, constant


def _worst(commands: list[float], gain: float, integral: float, lead: float, time: float) -> float:
    quadratic, linear, constant = _form(commands, gain, integral, lead, time)
    speed = np.linalg.solve(-2.0 * quadratic, linear)
    return float(speed @ quadratic @ speed + linear @ speed + constant)


def _sent(commands: list[float], kept: int = 0) -> Commands:
    ring = Commands(kept or len(commands) + 1)
    for command in commands:
        ring.send(command)
    return ring


@pytest.mark.parametrize("seed", range(12))
def test_the_loss_of_a_sequence_is_that_of_the_worst_motion(seed: int) -> None:
    random = np.random.default_rng(seed)
    gain, time = random.uniform(50.0, 2000.0), random.choice([1e-3, 4e-3])
    integral = gain * random.choice([0.0, 20.0, 100.0])
    commands = random.uniform(-1.0, 1.0, random.integers(1, 5)).tolist()
    lead = random.uniform(-0.02, 0.02) if integral else 0.0
    ring = _sent(commands)
    found = _settings(gain, integral, time=time).sequence_loss(lead, ring, len(commands), len(commands) - 1)
    worst = _worst(commands, gain, integral, lead, time)
    scale = gain * time * max(abs(c) for c in commands) ** 2
    assert worst <= found + 1e-9 * scale
    assert found - worst <= 4e-3 * scale  # what the steps leave


@pytest.mark.parametrize("seed", range(12))
def test_the_gain_by_encoder_and_command_is_the_least_of_all_motions_of_that_way(seed: int) -> None:
    random = np.random.default_rng(100 + seed)
    gain, time = random.uniform(50.0, 2000.0), random.choice([1e-3, 4e-3])
    integral = gain * random.choice([0.0, 20.0, 100.0])
    command, moved = random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0) * time
    lead = random.uniform(-0.02, 0.02) if integral else 0.0
    ring = _sent([command, 0.0])
    found = _settings(gain, integral, time=time).gained(lead, ring, moved)
    quadratic, linear, constant = _form([command], gain, integral, lead, time)
    step = time / _STEPS  # least -loss with the way given: a bordered linear system
    system = np.block(
        [[-2.0 * quadratic, step * np.ones((_STEPS, 1))], [step * np.ones((1, _STEPS)), np.zeros((1, 1))]]
    )
    speed = np.linalg.solve(system, np.append(linear, moved))[:-1]
    least = -float(speed @ quadratic @ speed + linear @ speed + constant)
    scale = gain * time * (abs(command) + abs(moved) / time) ** 2 + 1e-12
    assert found <= least + 1e-9 * scale
    assert least - found <= 4e-3 * scale


@pytest.mark.parametrize("evenness", [1.0, 0.4])
def test_a_drive_at_its_torque_limit_proves_no_more_than_it_brakes(evenness: float) -> None:
    random, gain, limit, time, acceleration = np.random.default_rng(5), 1600.0, 300.0, 2e-3, 400.0
    settings = replace(
        _settings(gain, 0.0, time=time), torque_limit=limit, acceleration=acceleration, evenness=evenness
    )
    at_limit = 0
    for _ in range(300):
        step = time * random.uniform(evenness, 1.0) / 400
        slopes = np.repeat(random.uniform(-acceleration, acceleration, 8), 50)
        speed = random.uniform(-2.0, 2.0) + np.cumsum(slopes) * step
        command = random.uniform(-1.5, 1.5)
        torque = np.clip(gain * (command - speed), -limit, limit)
        at_limit += bool((abs(torque) == limit).any())
        ring = _sent([command, 0.0])
        found = settings.gained(0.0, ring, float(speed.sum() * step))
        assert found <= -float((torque * speed).sum() * step) + 1e-3  # of the steps
    assert at_limit > 100


def test_a_hold_shorter_than_the_sample_time_was_faster_and_may_reach_the_torque_limit() -> None:
    """0.9 m/s over T are 1.125 m/s where the hold lasted 0.8 T."""
    settings = replace(_settings(100.0, 0.0), torque_limit=110.0)
    loop = LoopState(velocity=0.9)
    assert not settings.may_limit(loop, 0.0, 0)
    assert replace(settings, evenness=0.8 / 1.2).may_limit(loop, 0.0, 0)


@pytest.mark.parametrize("seed", range(16))
def test_what_is_allowed_loses_just_the_budget(seed: int) -> None:
    random = np.random.default_rng(200 + seed)
    gain, time, delay = random.uniform(50.0, 2000.0), 1e-3, int(random.integers(0, 4))
    integral = gain * random.choice([0.0, 60.0])
    under_way = random.uniform(-0.3, 0.3, delay).tolist()
    lead = random.uniform(-0.01, 0.01) if integral else 0.0
    settings, sign = _settings(gain, integral, delay=delay, time=time), float(random.choice([-1.0, 1.0]))
    ring = _sent([*under_way, 0.0])
    ring.newest -= 1
    budget = random.uniform(0.0, 0.3)
    speed = settings.fastest(lead, ring, budget, sign)
    worst = _worst([*under_way, sign * speed], gain, integral, lead, time)
    assert worst <= budget + 1e-9 or speed == 0.0
    if speed > 0.0:
        assert worst == pytest.approx(budget, rel=5e-3, abs=1e-6)


@pytest.mark.parametrize("losses", [1, 2, 3])
@pytest.mark.parametrize("delay", [0, 1, 2])
def test_no_way_of_losing_commands_loses_more_than_is_counted(delay: int, losses: int) -> None:
    random = np.random.default_rng(7)
    for _ in range(50):
        settings = _settings(500.0, 0.0, delay=delay, losses=losses)
        sent = random.uniform(-0.3, 0.3, delay + losses + 1).tolist()
        ring = _sent(sent, delay + losses + 2)
        budget = random.uniform(0.0, 0.2)
        speed = settings.fastest(0.0, ring, budget, 1.0)
        ring.send(speed)
        most = max(_losses_of(sent[1:] if len(sent) > delay + losses else sent, speed, delay, losses, settings))
        assert most <= settings.loss_under_way(0.0, ring) + 1e-12
        if speed > 0.0:
            assert most <= budget + 1e-12


def _losses_of(sent: list[float], speed: float, delay: int, losses: int, settings: VelocityLoop) -> list[float]:
    """Returns the loss of every pattern of lost RPDOs, up to so many in a row; behind the new command comes 0."""
    everything = [*sent, speed, *[0.0] * losses]
    first = len(sent) - delay  # place of the command of the hold that begins now
    found = []
    for pattern in range(1 << (delay + losses + 1)):
        for start in range(max(0, first - losses), first + 1):  # what acts already is one of the last that were sent
            acting, row, total, allowed = everything[start - 1] if start else 0.0, first - start, 0.0, True
            for hold in range(delay + losses + 1):
                if pattern >> hold & 1:
                    row += 1
                    allowed = allowed and row <= losses
                else:
                    acting, row = everything[first + hold], 0
                total += 0.25 * settings.gain * settings.sample_time * acting * acting
            if allowed:
                found.append(total)
    return found


@pytest.mark.parametrize("losses", [0, 1, 2])
@pytest.mark.parametrize("sent", [(0.0, 0.0, 0.0, 0.0), (0.05, 0.1, 0.0, 0.02), (0.3, 0.0, 0.0, 0.0)])
def test_the_fastest_command_uses_up_the_budget_and_no_more_whatever_may_be_lost(
    losses: int, sent: tuple[float, ...]
) -> None:
    loop = _settings(600.0, 0.0, losses=losses)
    budget = 0.02  # [J]
    fastest = loop.fastest(0.0, _sent(list(sent), 6), budget, 1.0)
    assert fastest > 0.0
    for part, is_covered in ((1.0, True), (1.001, False)):
        ring = _sent([*sent, part * fastest], 6)
        assert (loop.loss_under_way(0.0, ring) <= budget * (1.0 + 1e-9)) is is_covered

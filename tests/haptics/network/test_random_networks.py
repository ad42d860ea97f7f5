"""Random networks over ten decades of stiffness, with hardening and double wells: energies close within bounds."""

import random

import pytest
from networks import random_network

from canhaptic.haptics.network.line import FURTHEST, Line
from canhaptic.haptics.network.scale import EVALUATIONS as SCALE_EVALUATIONS
from canhaptic.haptics.network.step import EVALUATIONS, advance, new_room
from canhaptic.haptics.network.tables import stored_energy


def random_sample(rng):
    """A network, its state, the motion of its port and a sample time."""
    network = random_network(rng)
    state = [
        rng.gauss(0.0, 1.0) * (10.0 ** rng.uniform(-5, -2) if i % 2 == 0 else 10.0 ** rng.uniform(-3, 0) / k)
        for i, k in enumerate(network.tables.stiffness)
    ]
    return network, state, [rng.gauss(0.0, 1.0) * 10.0 ** rng.uniform(-7, -2.5)], 10.0 ** rng.uniform(-4, -2)


def judge_model_step(network, state, motion, sample_time):
    """Solves one step; returns (evaluations, balance residual over the largest energy, port energy, losses, step)."""
    tables = network.tables
    room = new_room(network.states, len(tables.viscous))
    evaluations = advance(tables, state, motion, sample_time, room, None)
    before = stored_energy(tables, state)
    after = stored_energy(tables, [x + s for x, s in zip(state, room.step, strict=True)])
    effort = sum(row[0] * e for row, e in zip(tables.gain, room.efforts, strict=True))
    effort += sum(row[0] * loss for row, loss in zip(tables.on_ports, room.losses, strict=True))
    lost = sample_time * sum(loss * flow for loss, flow in zip(room.losses, room.flows, strict=True))
    assert all(loss * flow >= 0.0 for loss, flow in zip(room.losses, room.flows, strict=True))
    received = effort * motion[0]
    between = max(abs(e * s) for e, s in zip(room.efforts, room.step, strict=True))  # flows among the storages
    error = abs(after - before - received + lost) / max(before, after, abs(received), lost, between)
    return evaluations, error, received, lost, list(room.step)


def judge(cases, seed):
    rng = random.Random(seed)
    unsolved = 0
    for _ in range(cases):
        network, state, motion, sample_time = random_sample(rng)
        evaluations, error, received, lost, step = judge_model_step(network, state, motion, sample_time)
        assert abs(evaluations) <= EVALUATIONS
        if evaluations > 0:
            assert error <= 1e-12
        else:
            unsolved += 1
        judge_scaled_step(rng, network, state, step, received, lost)
    return unsolved


def judge_scaled_step(rng, network, state, step, received, lost):
    """Solves the scalar balance of the same step, with an energy that the hold need not have given."""
    energy = received * rng.uniform(-1.0, 2.0) + rng.choice((-1, 1)) * 10.0 ** rng.uniform(-12, 0) * rng.random()
    loss = lost * rng.random()
    line = Line(network.tables, None, state, step)
    scale = line.solve(energy, loss)
    taken = line.taken(scale.share, loss).energy
    size = max(stored_energy(network.tables, state), abs(energy), abs(loss * scale.share))
    assert scale.evaluations <= SCALE_EVALUATIONS
    assert abs(scale.share) <= FURTHEST or energy <= 0.0
    if scale.found and abs(scale.share) < FURTHEST:
        assert abs(taken - energy) <= 1e-12 * size
    elif energy > 0.0:  # more came in than the furthest step takes up: what is over leaks, nothing is created
        assert abs(scale.share) == FURTHEST
        assert taken <= energy + 1e-12 * size


def test_eight_hundred_random_networks_close_their_energy():
    assert judge(800, 1) <= 8  # one in a hundred: those are flagged, and rendered as no torque


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_hundred_thousand_random_networks_close_their_energy():
    assert judge(100_000, 2) <= 1000

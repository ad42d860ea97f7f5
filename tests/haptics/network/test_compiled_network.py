"""The compiled equation is the interpreted one: the same source, the same answers."""

import random

import pytest
from networks import EXAMPLE, Table, group, random_network, rendered

from canhaptic.errors import ParameterError
from canhaptic.haptics.network.model import Network, UserEnergy
from canhaptic.haptics.network.sampled_network import SampledNetwork

numba = pytest.importorskip("numba")


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_compiled_network_moves_as_the_interpreted_one():
    rng = random.Random(4)
    for _ in range(60):
        network = random_network(rng)
        pair = [SampledNetwork(network, 1e-3), SampledNetwork(network, 1e-3, compiled=True)]
        motion = [rng.gauss(0.0, 1e-4) for _ in range(10)]
        for d in motion:
            solved = [followed.advance((0.0,), (d,), 1e-3) for followed in pair]
            assert solved[0] == solved[1]
            assert pair[1].state == pytest.approx(pair[0].state, rel=1e-9, abs=1e-12)
            pair[1].state[:] = pair[0].state  # double wells part ways on the last bit
            if not solved[0]:
                break
            assert pair[1].evaluations == pair[0].evaluations


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_compiled_group_renders_what_the_interpreted_one_does():
    torques = []
    for compiled in (False, True):
        controller = group(EXAMPLE, delay=1, compiled=compiled)
        plant = Table(1e-3, lambda t, q, v, _f: -200.0 * (q - 0.02 * t) - 3.0 * v, longest=5e-4)
        found = []
        rendered(controller, plant, 200, 1, lambda balance, _plant, into=found: into.append(balance.torques[0]))
        torques.append(found)
    assert max(abs(t) for t in torques[0]) > 0.1
    assert torques[1] == pytest.approx(torques[0], rel=1e-9, abs=1e-9)


def test_energies_given_as_functions_are_not_compiled():
    network = Network([UserEnergy(1, lambda x: 50.0 * x[0] ** 2, lambda x: [100.0 * x[0]])], gain=[[1.0]])
    with pytest.raises(ParameterError, match="leave it out"):
        SampledNetwork(network, 1e-3, compiled=True)


def test_without_numba_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "canhaptic.haptics.network.compiled", None)
    with pytest.raises(ParameterError, match=r"canhaptic\[fast\]"):
        group(EXAMPLE, compiled=True)

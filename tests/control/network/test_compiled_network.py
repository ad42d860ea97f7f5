"""The compiled equation is the interpreted one: the same source, the same answers."""

import random

import pytest

from canhaptic.control.port_hamiltonian.equation import new_workspace
from canhaptic.control.port_hamiltonian.network import Network, UserEnergy
from canhaptic.control.port_hamiltonian.newton import advance
from canhaptic.control.port_hamiltonian.sampled_network import SampledNetwork
from canhaptic.errors import ParameterError
from tests.control.network.networks import random_network
from tests.control.network.test_random_networks import random_sample

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


def test_energies_given_as_functions_are_not_compiled():
    network = Network([UserEnergy(1, lambda x: 50.0 * x[0] ** 2, lambda x: [100.0 * x[0]])], gain=[[1.0]])
    with pytest.raises(ParameterError, match="leave it out"):
        SampledNetwork(network, 1e-3, compiled=True)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_compiled_and_interpreted_solve_the_same_samples_to_the_last_bit():
    from canhaptic.control.port_hamiltonian.njit_equation import CompiledEquation

    rng = random.Random(9)
    late = 0
    for _ in range(4000):
        network, state, motion, sample_time = random_sample(rng)
        if not network.tables.moving:
            continue
        tables, size = network.tables, (network.states, len(network.tables.viscous))
        interpreted, compiled = new_workspace(*size), new_workspace(*size)
        evaluations = advance(tables, state, motion, sample_time, interpreted, None)
        if evaluations <= 12 and rng.random() < 0.9:
            continue  # most are solved at once: all others are compared, and some of these
        assert CompiledEquation(tables, compiled).advance(state, motion, sample_time, True) == evaluations
        assert compiled.step == interpreted.step
        assert compiled.efforts == interpreted.efforts
        late += evaluations > 26
    assert late > 5

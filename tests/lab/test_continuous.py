"""The continuous environments of `canhaptic.lab` against scipy; against one another: `test_batch_beside_continuous`."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from canhaptic.control.environments.coulomb_surface import CoulombSurface
from canhaptic.control.environments.detents import Detents
from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.environments.hardening_wall import HardeningWall
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.viscoelastic_medium import ViscoelasticMedium
from canhaptic.errors import InputError
from canhaptic.lab.batch.scalar import continuous_reference
from canhaptic.sim.plant.effects.coulomb_friction import CoulombFriction
from canhaptic.sim.plant.effects.viscous_friction import ViscousFriction
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import RecordedMotion, SinusoidMotion, UserParameters
from tests.control.reference_loop import USER_S, continuous
from tools.bench.standard_cases import simulation_of

PLANT = PlantParameters(mass=0.25, damping=0.1)
USER = UserParameters(stiffness=300.0, damping=3.0, motion=SinusoidMotion(amplitude=0.03, frequency=1.0))
MS = 1_000_000


def reference(environment, cycles=1500, effects=()):
    return continuous_reference(environment, simulation_of(PLANT, USER, effects), MS, cycles)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stiffness", "damping", "surface"), [(1000.0, 5.0, 0.0), (1e5, 50.0, 0.002), (50.0, 0.0, -0.01)]
)
def test_the_wall_is_that_of_an_independent_dop853(stiffness, damping, surface):
    wall = SpringDamperWall(stiffness=stiffness, damping=damping, position=surface)
    found = reference(wall)
    times = np.arange(1500) * 1e-3
    position, _ = continuous(USER_S, stiffness, damping, surface, times)
    assert np.abs(found.position - position).max() < 2e-9


@pytest.mark.slow
def test_a_relaxing_medium_is_that_of_an_independent_integration():
    medium = ViscoelasticMedium(stiffness=800.0, relaxation_time=0.05, damping=2.0)

    def rate(t, z):
        q, v, s = z
        w = 2.0 * np.pi
        hand = 300.0 * (0.03 * np.sin(w * t) - q) + 3.0 * (0.03 * w * np.cos(w * t) - v)
        return [v, (hand - 800.0 * s - 2.1 * v) / 0.25, v - s / 0.05]

    solved = solve_ivp(rate, (0.0, 0.999), [0.0, 0.0, 0.0], "DOP853", np.arange(1000) * 1e-3, rtol=1e-11, atol=1e-14)
    found = reference(medium, 1000)
    assert np.abs(found.position - solved.y[0]).max() < 1e-9
    force = -800.0 * solved.y[2] - 2.0 * solved.y[1]
    assert np.abs(found.fine_torque[::5] - force).max() < 1e-3 * np.abs(force).max()


@pytest.mark.slow
def test_a_bristle_slides_at_its_limit_and_lets_go_at_the_reversal():
    surface = CoulombSurface(friction=1.5, stiffness=2000.0, damping=0.5)

    def rate(t, z):
        q, v, s = z
        w = 2.0 * np.pi
        hand = 300.0 * (0.03 * np.sin(w * t) - q) + 3.0 * (0.03 * w * np.cos(w * t) - v)
        sliding = abs(s) >= 1.5 / 2000.0 and s * v > 0.0
        return [v, (hand - 2000.0 * s - 0.6 * v) / 0.25, 0.0 if sliding else v]

    solved = solve_ivp(rate, (0.0, 0.35), [0.0, 0.0, 0.0], "RK45", np.arange(350) * 1e-3, max_step=3e-5)
    found = reference(surface, 350)
    assert np.abs(found.position - solved.y[0]).max() < 1e-5  # the judge sees its events at the ends of steps
    assert np.abs(found.fine_torque).max() < 1.5 + 0.5 * 0.3


@pytest.mark.slow
def test_a_recorded_hand_moves_the_judge_as_it_moves_the_plant():
    motion = RecordedMotion.model_construct(type="recorded")
    motion._rows = ((0.0, 0.0), (0.05, 0.01), (0.12, -0.004), (0.2, 0.002))
    hand = UserParameters.model_construct(stiffness=200.0, damping=4.0, motion=motion)
    found = continuous_reference(FreeSpace(), simulation_of(PLANT, hand), MS, 300)
    moved = Plant(PLANT, hand, [], MS).run(np.zeros(299))
    assert np.abs(found.position[1:] - moved).max() < 1e-8 < found.travel  # the plant's times are ticks of T / 2^24


@pytest.mark.slow
def test_an_environment_that_is_not_affine_takes_any_plant():
    hard = HardeningWall(stiffness=200.0, hardening=2e6, damping=2.0)
    assert reference(hard, 300).method.startswith("DOP853")
    assert reference(Detents(peak=2.0, pitch=0.01, damping=0.5), 300).variation > 1.0
    dry = reference(hard, 300, [CoulombFriction(kinetic=0.1, static=0.2)])
    assert 1e-5 < np.abs(dry.position - reference(hard, 300).position).max() < 0.01


def test_an_environment_without_equations_is_refused_although_it_descends_from_one_that_has_them():
    class Ledge(SpringDamperWall):
        def contact(self, position):
            return int(position < self.position or position > 0.01)

    with pytest.raises(InputError, match="got Ledge, for which there is no continuous run, expected one of: Spring"):
        reference(Ledge(stiffness=100.0, damping=1.0), 300)


def test_an_effect_without_equations_is_refused():
    class Eddies(ViscousFriction):
        type: str = "eddies"  # type: ignore[assignment]

    with pytest.raises(InputError, match="got 'eddies', for which the textbook plant has no equations"):
        reference(Detents(peak=2.0, pitch=0.01, damping=0.5), 300, [Eddies(damping=1.0)])

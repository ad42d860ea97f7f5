"""A hand that climbs to where energy comes out of certified torques, on a plant that shares nothing with the package.

`make bench Q=attack` does the same for thousands of loops.
"""

import pytest

pytest.importorskip("numba")

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters
from tools.attack.climb import Attack
from tools.attack.holes import HOLES, attack_on, random_attack
from tools.attack.plant import STRAIN, TAKEN_IN, Hand, Rig, V, X, energy_of, hold
from tools.bench.attack import attacked
from tools.kept_runs import run_kept

OPEN: frozenset[str] = frozenset()
"""Ways out that no declaration closes yet; each is needed here."""


def least(attack: Attack, hands: int) -> float:
    return min(attack.run(seed) for seed in range(hands))


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("hole", HOLES, ids=lambda hole: f"{hole.name}: {hole.what}")
def test_every_known_way_out_is_found_where_its_mend_is_not_declared(hole):
    assert least(attack_on(hole, mended=False), 30) < -1e-6  # a thousand times the rounding of a closed one


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("hole", HOLES, ids=lambda hole: f"{hole.name}: {hole.what}")
def test_a_declared_way_out_is_closed(hole):
    assert (least(attack_on(hole, mended=True), 30) >= -1e-9) is (hole.name not in OPEN)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_no_hand_gets_energy_out_of_an_ideal_loop():
    ideal = [seed for seed in range(120) if random_attack(seed).is_ideal][:15]
    assert min(least(random_attack(seed), 8) for seed in ideal) >= -1e-9


@pytest.mark.slow
@pytest.mark.parametrize("creeps", [False, True], ids=["spring", "Dahl"])
def test_bristles_give_back_no_more_than_is_stated_of_them(creeps):
    """Every hand, friction alone declared: more than rounding, and within f_c^2 / 2 s."""
    rig = Rig(1e-3, 0.25, 0.1, friction=3.0, bristles=1e4, creeps=creeps)
    loop = LoopProperties(
        sample_time=1e-3, moving_mass=0.25, device_damping_bound=0.1, device_friction=3.0, encoder_count=1e-6
    )
    wall = SpringDamperWall(stiffness=2e4, damping=0.0, position=0.0)
    attack = Attack(rig, wall, loop, GuardedParameters(hand_force=None), Hand(60.0, 60.0, 0.5))
    assert -(3.0**2) / 2e4 <= least(attack, 6) < -1e-5


def test_the_plant_of_the_attack_conserves_energy():
    rig = Rig(0.01, 0.25, damping=0.3, friction=0.4, lag=1e-3, window=5e-4)
    state = [0.0] * 8
    state[V] = 0.2
    start = energy_of(rig, state)
    work = 0.0
    for k in range(40):
        before = state[X]
        hold(rig, state, 2.0 * (-1) ** (k // 5), 1.5, 0.01)
        work += 1.5 * (state[X] - before)
    assert energy_of(rig, state) - start == pytest.approx(work - state[TAKEN_IN] - state[7], abs=1e-12)
    assert state[7] > 0.01


def test_the_bristles_of_the_attack_swing_as_a_spring_and_slide_at_the_friction():
    rig = Rig(0.01, 0.25, friction=2.0, bristles=1e4)
    state = [0.0] * 9
    state[V] = 0.01  # 50 um on 1e4 N/m: 0.5 N, below sliding
    hold(rig, state, 0.0, 0.0, 0.0157079632679)  # half a period: 2 pi sqrt(m / s)
    assert state[V] == pytest.approx(-0.01, rel=1e-3)
    assert state[STRAIN] == pytest.approx(0.0, abs=1e-7)
    state[V] = 1.0
    hold(rig, state, 0.0, 0.0, 0.02)
    assert state[STRAIN] == pytest.approx(2e-4)
    assert state[V] == pytest.approx(1.0 - 2.0 * 0.02 / 0.25, rel=2e-3)


def test_an_attack_goes_on_where_it_was_stopped(tmp_path):
    kept = tmp_path / "attack_runs.jsonl"
    kept.write_text("[0, -1e-13]\n[1, 0.0]\n[7, -1.0]\n", encoding="utf-8")
    assert run_kept(attacked, range(2), kept, 1, minutes=0.0) == {0: -1e-13, 1: 0.0}

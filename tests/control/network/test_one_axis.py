"""A group of one spring and one damper is the algorithm of one axis, to rounding."""

import math
import random
from typing import Any

import pytest

from canhaptic.control.balance import Branch, Certificate
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.mechanisms.kinematics import Identity
from canhaptic.control.multi_axis import build_group_controller
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import Guarded, GuardedParameters
from canhaptic.control.passivity.unprotected import Unprotected
from canhaptic.control.port_hamiltonian.shapes.plane import Plane
from tests.adversary.late_axis import climb
from tests.control.network.networks import group

ENERGIES = ("h_i", "h_pas", "h_m", "h_r", "h_s", "h_dis", "gen", "deficit", "leak", "paid")
WALLS = [(800.0, 0.0), (3e3, 0.0), (200.0, 0.0)]


def pair(stiffness, damping):
    return (
        SpringDamperWall(stiffness=stiffness, damping=damping),
        Plane(normal=(2.0,), stiffness=stiffness, damping=damping),
    )


def positions(one, cycles, delay, start=0.003, clip=math.inf):
    """Runs the controller of one axis against a trembling user; yields what a second controller is to see."""
    rng, quarter = random.Random(3), 0.25e-3
    q, v, t, held, pending = start, 0.0, 0.0, 0.0, [0.0] * delay
    for _ in range(cycles):
        balance = one.step(q, held)
        yield q, held, balance
        pending.append(max(-clip, min(clip, balance.torque)))
        held = pending.pop(0)
        for _ in range(4):
            reach, speed = 0.03 * math.cos(2 * math.pi * t), -0.06 * math.pi * math.sin(2 * math.pi * t)
            v += quarter * (held + 300.0 * (reach - q) + 3.0 * (speed - v) + rng.gauss(0.0, 2.0) - 0.1 * v) / 0.25
            q, t = q + quarter * v, t + quarter


@pytest.mark.slow_but("own2-*-800.0-0.0-1", "own4-*-800.0-0.0-1", "own0-*-800.0-0.0-0")
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize(("stiffness", "damping"), WALLS)
@pytest.mark.parametrize(
    ("own", "known", "clip"),
    [
        ({}, {}, math.inf),
        ({"hand_force": 5.0, "alpha": "100 s/m^2"}, {"device_damping_bound": 0.4}, math.inf),
        ({"hand_speed": 0.5, "energy_allowance": 1e-3}, {"device_damping": 0.1}, math.inf),
        ({"hand_force": 2.0}, {"encoder_count": 1e-6, "torque_quantum": 1e-3}, math.inf),
        ({"energy_allowance": 1e-3}, {}, 3.0),
    ],
)
def test_the_account_of_a_guarded_group_is_that_of_guarded(delay, stiffness, damping, own, known, clip):
    wall, plane = pair(stiffness, damping)
    loop = LoopProperties(sample_time=1e-3, delay=delay, **{"moving_mass": 0.25, "device_damping_bound": 0.0, **known})
    push = {"hand_push": own.get("hand_force", 0.0), "earned_energy": 0.0}
    one = Guarded(wall, GuardedParameters(**push, **own), loop)
    group = build_group_controller(plane, Identity(axes=1), "guarded", GuardedParameters(**own), [loop])
    strongest = richest = worst_torque = worst_energy = 0.0
    for q, held, alone in positions(one, 1000, delay, clip=clip):
        together = group.step([q], [held])
        strongest, richest = max(strongest, abs(alone.torque)), max(richest, alone.h_s)
        worst_torque = max(worst_torque, abs(together.torques[0] - alone.torque))
        for name in ENERGIES:
            worst_energy = max(worst_energy, abs(getattr(together.account, name) - getattr(alone, name)))
    assert strongest > 1.0  # the wall was touched
    # where an encoder is coarse, the window of velocities begins a motion of one hold earlier or later
    allowed = 2e-2 if loop.encoder_count else 1e-9
    assert worst_torque <= allowed * strongest
    assert worst_energy <= allowed * richest


@pytest.mark.slow_but("3000.0-4.0-1")
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize(("stiffness", "damping"), [(800.0, 0.0), (3e3, 4.0)])
def test_an_unprotected_group_is_unprotected_on_one_axis_and_books_what_sampling_creates(delay, stiffness, damping):
    wall, plane = pair(stiffness, damping)
    loop = LoopProperties(sample_time=1e-3, delay=delay, moving_mass=0.25)
    one = Unprotected(wall, Unprotected.parameters_type(), loop)
    group = build_group_controller(plane, Identity(axes=1), "unprotected", None, [loop])
    strongest = created = stored = 0.0
    for q, held, alone in positions(one, 1000, delay):
        together = group.step([q], [held])
        account, strongest = together.account, max(strongest, abs(alone.torque))
        created, before, stored = created + account.gen, stored, account.h_s
        assert stored == pytest.approx(before + account.h_i - account.h_r + account.gen - account.leak, abs=1e-15)
        for name in ("h_i", "h_s") if damping else ENERGIES:
            assert getattr(account, name) == pytest.approx(getattr(alone, name), rel=1e-9, abs=1e-15)
        if not damping or account.branch != Branch.START.value:  # a damper of a group acts inside the wall alone
            assert together.torques[0] == pytest.approx(alone.torque, rel=1e-9, abs=1e-12)
    assert strongest > 1.0
    assert created > 5e-4  # [J]: what the sampled wall makes of nothing


class _OneOfGroup:
    """A group of one axis as a controller of one."""

    def __init__(self, group):
        self.group, self.certificates = group, set()

    def step(self, position, held):
        balance = self.group.step([position], [held])
        if any(balance.torques):
            self.certificates.add(balance.account.certificate)
        return balance.account._replace(torque=balance.torques[0])


class _WithResolution(_OneOfGroup):
    @property
    def energy_resolution(self):
        return self.group.energy_resolution


@pytest.mark.slow_for("0")
@pytest.mark.parametrize("delay", [0, 1])
def test_a_group_is_certified_for_late_torques_and_books_the_middle_of_what_they_leave_possible(delay):
    made = []

    def make(lag=3e-4, of=_WithResolution):
        loop = LoopProperties(
            sample_time=1e-3, delay=delay, moving_mass=0.25, device_damping_bound=0.0, current_lag=lag
        )  # fmt: skip
        parameters = GuardedParameters(hand_force=5.0)
        made.append(of(build_group_controller(pair(1e4, 0.0)[1], Identity(axes=1), "guarded", parameters, [loop])))
        return made[-1]

    how: dict[str, Any] = {"pull": 5.0, "push": 30.0, "lag": 3e-4, "steps": 30}
    assert climb(make, random.Random(1), 1e-3, delay, **how)[1] <= 1e-9
    assert max(one.group.energy_resolution for one in made) > 1e-6
    named = {certificate for one in made for certificate in one.certificates}
    assert Certificate.HAND_FORCE.value in named
    assert Certificate.NONE.value not in named
    assert climb(lambda: make(0.0), random.Random(1), 1e-3, delay, **how)[1] > 1e-5
    assert climb(lambda: make(of=_OneOfGroup), random.Random(1), 1e-3, delay, **how)[1] > 1e-6  # the middle alone


@pytest.mark.slow_but("1")
@pytest.mark.parametrize("delay", [0, 1])
def test_a_group_pressed_into_a_wall_with_late_torques_holds_it(delay):
    """Doubt puts the account into debt at the entry; a torque that takes energy in for certain is sent all the same."""
    loop = LoopProperties(
        sample_time=1e-3, delay=delay, moving_mass=0.25, device_damping_bound=1.0, sync_jitter=0.02, current_lag=1e-4
    )  # fmt: skip
    plane, own = Plane(normal=(1.0, 1.0), stiffness=2e4, damping=20.0), GuardedParameters(hand_force=1.0)
    group = build_group_controller(plane, Identity(axes=2), "guarded", own, [loop, loop])
    q, v, pending = 0.01, -0.3, [0.0] * delay
    held = 0.0
    for _ in range(700):
        pending.append(group.step([q, q], [held, held]).torques[0])
        held = pending.pop(0)
        for _ in range(4):
            v += (held - 10.0 - 2.0 * v) / 0.25 * 0.25e-3
            q += v * 0.25e-3
    assert held == pytest.approx(10.0, rel=0.01)
    assert q == pytest.approx(-10.0 / 2e4, rel=0.3)


@pytest.mark.parametrize("delay", [0, 1])
def test_a_slow_motion_that_lasted_longer_certifies_a_group_no_fast_one(delay):
    """Three sample times of it, a SYNC or two having been skipped; as for one axis."""
    torques = []
    for hold_length in (1.0, 3.0):
        of = group(Plane(normal=(1.0,), stiffness=1e4, damping=0.0), 1, sample_time=1e-2, delay=delay, hand_force=5.0)
        of.step([1e-3], [0.0])
        of.note_skipped_syncs(hold_length)
        torques.append(of.step([-5e-3], [0.0]).torques[0])
        assert of.step([-11e-3], [0.0]).torques[0] > 0.0  # the next hold is one of the usual length
    assert torques[0] > 2.0 * torques[1]

"""The guard of an admittance display against hands that attack it, on a drive written apart from the package (AD3)."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from canhaptic.control.admittance import build_display_controller, build_display_group
from canhaptic.control.admittance.admittance_environment import AdmittanceMass
from canhaptic.control.admittance.group_environment import GroupMass
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.control.balance import Certificate
from canhaptic.errors import ControlError, ParameterError
from tests.adversary import display as attack

_ACCELERATION = 150.0


@dataclass(frozen=True)
class _Rig:
    mass: float = 2.0
    bandwidth: float = 100.0  # [Hz]
    corner: float = 0.0  # of the integral [rad/s]
    time: float = 1e-3
    delay: int = 1
    latency: int = 0
    losses: int = 0
    allowance: float = 0.0
    virtual_mass: float = 1.0
    damping: float = 0.0
    count: float = 0.0
    acceleration: float = _ACCELERATION
    hand_force: float = 0.0
    torque_limit: float = 1e9
    slew: float = 1e-6
    jitter: float = 0.0  # declared
    uneven: float = 0.0  # every hold lasts T (1 +- this), or the longest of them where it is negative

    @property
    def gain(self) -> float:
        return 2.0 * math.pi * self.bandwidth * self.mass

    def known(self, **declared: float) -> tuple[GuardedAdmittanceParameters, AdmittanceProperties]:
        properties = AdmittanceProperties(
            sample_time=self.time, delay=self.delay, sampling="mean", latency=self.latency, force_slew=self.slew,
            handle_acceleration=self.acceleration, encoder_count=self.count, speed_limit=3.0, acceleration_limit=1000.0,
            torque_limit=self.torque_limit, jitter=self.jitter,
        )  # fmt: skip
        known = {
            "drive_mass": self.mass, "loop_gain": self.gain, "integral_gain": self.gain * self.corner,
            "largest_hand_force": self.hand_force, **declared,
        }  # fmt: skip
        parameters = GuardedAdmittanceParameters(
            spread=0.0, energy_allowance=self.allowance, max_consecutive_losses=self.losses, **known
        )
        return parameters, properties

    def controller(self, **declared: float) -> Any:
        environment = AdmittanceMass(mass=self.virtual_mass, damping=self.damping)
        return build_display_controller(environment, "guarded", *self.known(**declared))

    def controller_of_two(self, **declared: float) -> Any:
        parameters, properties = self.known(**declared)
        return build_display_group(GroupMass(mass=self.virtual_mass), "guarded", parameters, [properties] * 2)

    def drive(self) -> attack.AttackedDrive:
        return attack.AttackedDrive(self.mass, self.gain, self.gain * self.corner, self.time, 10)


def _steady(hand: attack.Hand, substeps: int) -> attack.Hand:
    """Returns a hand whose force changes at SYNCs only, so that mean force times way is its energy."""
    state = [0, 0.0]

    def pull(drive: attack.AttackedDrive, command: float) -> float:
        if state[0] % substeps == 0:
            state[1] = hand(drive, command)
        state[0] += 1
        return state[1]

    return pull


class _Loop:
    """Drive and controller with the delays and losses of a rig."""

    def __init__(self, rig: _Rig, controller: Any, random: np.random.Generator) -> None:
        self.rig, self.controller, self.random = rig, controller, random
        self.drive = rig.drive()
        self.queue = [0.0] * (rig.delay + 1)
        self.late = [0.0] * rig.latency
        self.acting, self.row, self.impulse = 0.0, 0, 0.0
        self.least, self.fastest, self.cut = 0.0, 0.0, 0

    def sync(self, hand: attack.Hand, *, heard: bool = True) -> None:
        command = self.queue.pop(0)
        if self.row < self.rig.losses and self.random.random() < 0.3:
            self.row += 1
        else:
            self.row, self.acting = 0, command
        before, uneven = self.drive.state[0], self.rig.uneven
        lasts = 1.0 - uneven if uneven < 0.0 else 1.0 + uneven * float(self.random.integers(-2, 3)) / 2.0
        time = lasts * self.rig.time
        self.drive.hold(self.acting, hand, lasts)
        unlike = abs(self.drive.state[1] - (self.drive.state[0] - before) / time)
        self.fastest = max(self.fastest, 2.0 * unlike / time)
        mean = (self.drive.impulse - self.impulse) / time
        self.impulse = self.drive.impulse
        self.late.append(mean)
        force = self.late.pop(0)
        position = float(self.drive.state[0])
        if self.rig.count:
            position = round(position / self.rig.count) * self.rig.count
        try:
            balance = self.controller.step(position, -force) if heard else self.controller.sample_lost()
        except ControlError:
            assert self.fastest > self.rig.acceleration  # what is declared of the handle is not true
            self.queue.append(0.0)
            return
        self.queue.append(balance.torque)
        self.cut += balance.certificate in (5, 6)
        self.least = min(self.least, self.drive.energy)


def _attack(loop: _Loop, hand: attack.Hand) -> None:
    """Lets a hand have its way for 400 holds, or until it goes beyond what is declared of the handle."""
    for hold in range(400):
        loop.sync(hand)
        if loop.fastest > loop.rig.acceleration:
            assert hold >= 20
            return
        assert loop.least >= -loop.rig.allowance - 1e-9


def _random_rig(random: np.random.Generator) -> _Rig:
    corner = random.choice([0.0, 0.0, 20.0, 100.0])
    return _Rig(
        mass=random.uniform(0.5, 3.0), bandwidth=random.choice([25.0, 50.0, 100.0]), corner=corner,
        time=random.choice([1e-3, 4e-3]), delay=int(random.integers(0, 4)), latency=int(random.integers(0, 4)),
        losses=0 if corner else int(random.integers(0, 4)), allowance=random.choice([0.0, 1e-3]),
        virtual_mass=random.choice([0.1, 0.5, 1.0, 2.0, 5.0]), damping=random.choice([0.0, 5.0]),
        count=random.choice([0.0, 1e-6]),
    )  # fmt: skip


def _random_hand(random: np.random.Generator) -> attack.Hand:
    strength = random.uniform(5.0, 60.0)
    hands = (
        lambda: attack.bang_bang(strength, random),
        lambda: attack.negative_damper(random.uniform(5.0, 100.0), strength),
        lambda: attack.feed_and_take(strength, random.uniform(0.02, 0.3), random.uniform(0.02, 0.2)),
        lambda: attack.spring_and_mass(
            random.uniform(1e2, 5e3), random.uniform(0.0, 20.0), random.uniform(0.1, 5.0), strength
        ),
    )
    return hands[int(random.integers(len(hands)))]()


@pytest.mark.slow_but("2", "3")
@pytest.mark.parametrize("seed", range(12))
def test_no_hand_gets_more_than_it_gave(seed: int) -> None:
    random = np.random.default_rng(seed)
    rig = _random_rig(random)
    loop = _Loop(rig, rig.controller(), random)
    hand = _steady(_random_hand(random), loop.drive.substeps)
    _attack(loop, hand)


@pytest.mark.slow_but("0", "3")
@pytest.mark.parametrize("seed", range(10))
def test_no_hand_gets_more_than_it_gave_where_holds_are_as_uneven_as_declared(seed: int) -> None:
    random = np.random.default_rng(900 + seed)
    uneven = float(random.choice([0.05, 0.2, 0.5]))
    rig = replace(_random_rig(random), corner=0.0, virtual_mass=0.2, jitter=uneven, uneven=uneven)
    loop = _Loop(rig, rig.controller(), random)
    hand = _steady(_random_hand(random), loop.drive.substeps)
    _attack(loop, hand)


def _taken(rig: _Rig, share: float = 0.5, uneven: float = 0.0, **declared: float) -> float:
    """Returns the energy that is left [J] where a hand pushes, then takes all it can while no sample comes."""
    random = np.random.default_rng(1)
    loop = _Loop(rig, rig.controller(**declared), random)
    push = _steady(lambda _drive, _command: 12.0, loop.drive.substeps)
    for _ in range(round(0.15 / rig.time)):
        loop.sync(push)
    assert loop.fastest <= rig.acceleration
    assert loop.cut > 0  # the guard is at its limit
    loop.rig = replace(rig, uneven=uneven)
    take = attack.greedy(1e9, share)
    for _ in range(12):
        loop.sync(take, heard=False)
    loop.sync(attack.greedy(1e9, 0.0), heard=False)
    return loop.drive.energy


_SHARP = _Rig(virtual_mass=0.3, acceleration=8.0)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_the_worst_hand_takes_nearly_all_and_no_more(delay: int) -> None:
    rig = replace(_SHARP, delay=delay)
    left = _taken(rig)
    fed = 0.5 * rig.mass * 0.5**2
    assert -1e-9 <= left <= 0.15 * fed


@pytest.mark.parametrize("jitter", [0.05, 0.1])
def test_holds_longer_than_declared_cost_what_a_declared_jitter_keeps(jitter: float) -> None:
    assert _taken(replace(_SHARP, jitter=jitter), uneven=-jitter) >= -1e-9
    assert _taken(_SHARP, uneven=-jitter) < -1e-4


@pytest.mark.parametrize("name", ["drive_mass", "loop_gain"])
def test_a_mutant_that_declares_too_little_loses(name: str) -> None:
    true = {"drive_mass": _SHARP.mass, "loop_gain": _SHARP.gain}[name]
    assert _taken(_SHARP, **{name: 0.7 * true}) < -1e-3


@pytest.mark.slow_but("0", "3")
@pytest.mark.parametrize("seed", range(8))
def test_a_hand_of_bounded_force_gets_no_more_than_it_gave(seed: int) -> None:
    random = np.random.default_rng(300 + seed)
    rig = replace(_random_rig(random), corner=0.0, hand_force=random.choice([5.0, 20.0]), virtual_mass=0.2)
    loop = _Loop(rig, rig.controller(), random)
    hands = (
        attack.bang_bang(rig.hand_force, random),
        attack.negative_damper(100.0, rig.hand_force),
        attack.feed_and_take(rig.hand_force, random.uniform(0.02, 0.3), random.uniform(0.02, 0.2)),
    )
    hand = _steady(hands[seed % 3], loop.drive.substeps)
    _attack(loop, hand)


def _taken_by_braking(rig: _Rig, **declared: float) -> float:
    """Returns the least energy [J] where a hand pushes with all its force, then brakes with it, no sample coming."""
    loop = _Loop(rig, rig.controller(**declared), np.random.default_rng(1))
    for _ in range(40):
        loop.sync(_steady(lambda _drive, _command: rig.hand_force, loop.drive.substeps))
    assert loop.cut > 0
    while loop.drive.state[1] > 0.0:
        loop.sync(_steady(lambda _drive, _command: -rig.hand_force, loop.drive.substeps), heard=False)
    return loop.least


_WEAK_HAND = _Rig(virtual_mass=0.05, hand_force=10.0, mass=2.0, delay=1, acceleration=20.0)


def test_a_hand_of_bounded_force_lets_a_lighter_mass_be_felt() -> None:
    bound, free = (
        _Loop(rig, rig.controller(), np.random.default_rng(1))
        for rig in (_WEAK_HAND, replace(_WEAK_HAND, hand_force=0.0))
    )
    for loop in (bound, free):
        for _ in range(60):
            loop.sync(_steady(lambda _drive, _command: 10.0, loop.drive.substeps))
    assert bound.drive.state[1] > 1.3 * free.drive.state[1]


def test_a_hand_stronger_than_declared_takes_more_than_it_gave() -> None:
    assert _taken_by_braking(_WEAK_HAND) >= -1e-9
    assert _taken_by_braking(_WEAK_HAND, largest_hand_force=4.0) < -1e-4


def _taken_by_two(rig: _Rig, **declared: float) -> tuple[float, set[int]]:
    """Returns the least sum of energies [J] where two hands push with all their force, then brake; and certificates."""
    controller, drives = rig.controller_of_two(**declared), [rig.drive(), rig.drive()]
    queue, least, found = [(0.0, 0.0)] * (rig.delay + 1), 0.0, set[int]()
    for hold in range(160):
        before = [drive.impulse for drive in drives]
        for place, (drive, command) in enumerate(zip(drives, queue.pop(0), strict=True)):
            force = rig.hand_force * (1.0 - 0.5 * place) * (1.0 if hold < 40 else -1.0 if drive.state[1] > 0.0 else 0.0)
            drive.hold(command, _steady(lambda _drive, _command, force=force: force, drive.substeps))  # type: ignore[misc]
        forces = [(was - drive.impulse) / rig.time for drive, was in zip(drives, before, strict=True)]
        places = [float(drive.state[0]) for drive in drives]
        balance = controller.step(places, forces) if hold < 40 else controller.sample_lost()
        queue.append(balance.torques)
        found.add(balance.account.certificate)
        least = min(least, sum(drive.energy for drive in drives))
    return least, found


def test_two_hands_of_bounded_force_get_no_more_together_than_they_gave() -> None:
    """D4: the sum over the axes. A force on one axis that is larger than declared takes energy."""
    least, found = _taken_by_two(_WEAK_HAND)
    assert least >= -1e-9
    assert Certificate.LARGEST_HAND_FORCE.value in found
    assert _taken_by_two(_WEAK_HAND, largest_hand_force=4.0)[0] < -1e-4


def test_a_torque_limit_in_reach_leaves_the_loop_as_the_only_certificate() -> None:
    rig = replace(_WEAK_HAND, torque_limit=20.0)
    loop = _Loop(rig, rig.controller(), np.random.default_rng(1))
    for _ in range(60):
        loop.sync(_steady(lambda _drive, _command: 10.0, loop.drive.substeps))
    assert loop.cut > 0
    assert loop.controller.of._loop.known >= 0.0


def _out_and_back(rig: _Rig, holds: int) -> tuple[Any, float]:
    """Returns the controller behind a gap in which the handle moved as fast as it may, and the speed reached in it."""
    loop = _Loop(rig, rig.controller(), np.random.default_rng(1))
    for _ in range(4):
        loop.sync(lambda _drive, _command: 0.0)
    for _ in range(holds - 1):
        loop.controller.sample_lost()
    loop.sync(lambda _drive, _command: 0.0)
    return loop.controller, rig.acceleration * holds * rig.time / 4.0


@pytest.mark.parametrize("limit", [65.0, 1e3])
def test_a_torque_limit_may_be_reached_where_no_sample_shows_it(limit: float) -> None:
    """The handle is where it was before the gap; inside it the drive may have braked 75 N."""
    rig = _Rig(corner=20.0, acceleration=60.0, torque_limit=limit, bandwidth=50.0, delay=0)
    controller, speed = _out_and_back(rig, 8)
    assert (rig.gain * speed > limit) is (limit < 1e3)
    balance = controller.step(controller.of._each[0].port.position, 0.0)
    assert (balance.certificate == 4) is (limit < 1e3)


@pytest.mark.parametrize("losses", [0, 2])
def test_at_the_torque_limit_nothing_rests_on_the_hand_until_the_command_has_acted(losses: int) -> None:
    """Until an older one too has that may act in its place; of a force that is late, `latency` more are in doubt."""
    rig = replace(
        _WEAK_HAND, latency=3, torque_limit=105.0, virtual_mass=1e3, losses=losses, acceleration=50.0 / (2.5 + losses)
    )
    loop = _Loop(rig, rig.controller(), np.random.default_rng(1))
    made, hand = loop.controller.of, loop.controller.of._force
    lost, waited = [], []
    for force in (0.0, 0.0, 0.0, 150.0, *[0.0] * 8):  # moves fastest in the hold after: 52 N of the gain, 63 unseen
        waited.append(made._limited)
        loop.sync(lambda _drive, _command, push=force: push)  # type: ignore[misc]
        lost.append(hand.changes[hand.place] == -math.inf)
    assert waited == [0] * 5 + [*range(5 + losses, 0, -1), 0, 0, 0][:7]
    assert lost == [False] * 5 + [True] * (2 + losses) + [False] * (5 - losses)


def _known_of_declared(torque_limit: float) -> float:
    rig = _Rig(virtual_mass=1e3, delay=0, latency=1, torque_limit=torque_limit)
    loop = _Loop(rig, rig.controller(hand_stiffness=100.0, drive_friction=0.0), np.random.default_rng(1))
    for _ in range(20):
        loop.sync(_steady(lambda _drive, _command: 5.0, loop.drive.substeps))
    return float(loop.controller.of._declared.known)


def test_at_the_torque_limit_the_motion_proves_nothing_of_a_declared_hand() -> None:
    """What is left then is the energy at the sensor, less the most that the mass may carry."""
    assert _known_of_declared(20.0) < 0.0 < _known_of_declared(1e3)


def test_losses_are_not_declared_with_an_integral() -> None:
    rig = _Rig(corner=20.0, losses=1)
    with pytest.raises(ParameterError, match="max_consecutive_losses"):
        rig.controller()


@pytest.mark.parametrize("corner", [0.0, 20.0])
@pytest.mark.parametrize("delay", [0, 3])
def test_where_syncs_are_skipped_the_margin_stays_below_the_true_one(delay: int, corner: float) -> None:
    """The oldest command acts for 8 sample times, against a hand that takes all it can; the encoder alone tells it."""
    rig = replace(_SHARP, delay=delay, corner=corner, slew=1e7, allowance=0.05)
    loop = _Loop(rig, rig.controller(), np.random.default_rng(1))
    for force in (*[12.0] * 60, *[-4.0] * 3):
        loop.sync(lambda _drive, _command, force=force: force)  # type: ignore[misc]
    acting, take = loop.queue[0], attack.greedy(1e9, 0.5)
    assert acting != loop.queue[-1] or delay == 0
    for _ in range(8):
        loop.drive.hold(acting, take)
    loop.controller.note_skipped_syncs(8.0)
    loop.controller.step(float(loop.drive.state[0]), 0.0)
    true = loop.drive.energy - loop.drive.reserve
    assert true - 0.5 < loop.controller.of._loop.known <= true + 1e-9
    assert loop.controller.of._each[0].port.missed == 0


def _least_room(rig: _Rig, seed: int, **declared: float) -> tuple[float, float]:
    """Least of energy received, plus the allowance, less that of the drive and of its commands; and the largest [J]."""
    random = np.random.default_rng(seed)
    loop = _Loop(rig, rig.controller(**declared), random)
    hand = _steady(_random_hand(random), loop.drive.substeps)
    least, carried = math.inf, 0.0
    for _ in range(400):
        loop.sync(hand)
        if loop.fastest > rig.acceleration:
            break
        speed = float(loop.drive.state[1])
        commands = sum(loop.controller.of._each[0].commands.sent(age) ** 2 for age in range(rig.delay + 1))
        needed = 0.5 * rig.mass * speed**2 + 0.25 * rig.gain * rig.time * commands
        least, carried = min(least, loop.drive.energy + rig.allowance - needed), max(carried, needed)
    return least, carried


def _light(seed: int) -> _Rig:
    return replace(_random_rig(np.random.default_rng(seed)), corner=0.0, losses=0)


@pytest.mark.parametrize("seeds", [range(6), pytest.param(range(6, 150), marks=pytest.mark.slow)], ids=["few", "many"])
def test_a_speed_takes_the_energy_of_the_least_mass_that_check_says(seeds: range) -> None:
    found = [_least_room(_light(seed), seed) for seed in seeds]
    assert min(least for least, _ in found) >= -1e-9
    assert max(carried for _, carried in found) > 0.05  # something moved


@pytest.mark.slow
def test_a_gain_declared_too_small_lets_a_speed_come_from_less_energy() -> None:
    found = [_least_room(_light(seed), seed, loop_gain=0.6 * _light(seed).gain) for seed in range(6)]
    assert min(least for least, _ in found) < -1e-5

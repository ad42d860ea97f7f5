"""The meter of an axis against sums over its holds written anew, and the laziest motion against a search."""

import math
import random
from types import SimpleNamespace
from typing import Any

import pytest

from canhaptic.control.axis_meter import Accuracy, AxisMeter, SilentMeter
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.motion_checks import FrictionDeclared, FrictionWatch
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.unprotected import Unprotected
from canhaptic.meters import AxisPort
from canhaptic.signals import Sample

T = 1e-3


def close(found: float, expected: float) -> bool:
    return math.isclose(found, expected, rel_tol=1e-9, abs_tol=1e-18)


def accuracy_of(draw: random.Random) -> Accuracy:
    return Accuracy(
        sample_time=T,
        position=draw.choice([0.0, 1e-6]),
        torque_share=draw.choice([0.0, 0.02]),
        torque_offset=draw.choice([0.0, 0.1]),
        torque_limit=draw.choice([1.5, math.inf]),
        late=draw.choice([0.0, 2e-4]),
        late_speed=draw.choice([None, 0.4]),
        device_damping=draw.choice([None, 2.0]),
    )


def test_what_is_left_open_is_the_sum_of_what_position_torque_and_lateness_leave_open() -> None:
    for seed in range(80):
        draw = random.Random(seed)
        known = accuracy_of(draw)
        meter = AxisMeter(known)
        at, place = 0.0, draw.uniform(-1e-4, 1e-4)
        meter.take(place, 0.0, 0, touches=False)
        torque = changes = uneven = dissipated = speed = most = 0.0
        for _ in range(12):
            hold_length = draw.choice([0.2, 1.0, 1.0, 3.0])
            at, last, before = at + hold_length, place, torque
            place += draw.choice([0.0, draw.uniform(-1e-4, 1e-4), draw.uniform(-3e-6, 3e-6)])
            torque = draw.choice([0.0, torque, draw.uniform(-3.0, 3.0)])
            meter.take(place, torque, at, touches=True)
            holds, moved, position_uncertainty = max(0.5, hold_length), abs(place - last), 2.0 * known.position
            dissipated += (known.device_damping or 0.0) * max(0.0, moved - position_uncertainty) ** 2 / (holds * T)
            mean = moved / holds
            if torque or before:
                changes += abs(torque - before)
                fastest = known.late_speed or 2.0 * (max(mean, speed) + position_uncertainty) / T
                uneven += abs(torque - before) * known.late * fastest
                uneven += max(0.0, abs(torque) - known.torque_limit) * (moved + position_uncertainty)
                uneven += (known.torque_share * abs(torque) + known.torque_offset) * (moved + position_uncertainty)
                most = max(most, known.position * (changes + abs(torque)) + uneven)
            speed = mean
            assert close(meter.resolution, most), seed
            assert close(meter.dissipated, dissipated), seed
            assert meter.position == place


def test_lost_holds_leave_open_the_torque_at_the_largest_speed_and_what_the_algorithm_took_off() -> None:
    meter = AxisMeter(Accuracy(sample_time=T, position=1e-6, largest_speed=0.5))
    meter.leave_open(2.0, 3, 1e-4)
    meter.leave_open(0.0, 3, 1e-5)
    lost = 2.0 * 0.5 * 3 * T + 1e-4 + 1e-5
    assert close(meter.resolution, lost)
    for place, torque in ((0.0, 0.0), (1e-5, 4.0)):
        meter.take(place, torque, place * 1e5, touches=True)
    assert close(meter.resolution, lost + 1e-6 * 8.0)
    endless = AxisMeter(Accuracy())
    endless.leave_open(0.0, 3, 1e-5)
    assert endless.resolution == 1e-5  # no torque is unknown
    endless.leave_open(1e-9, 1, 0.0)
    assert endless.resolution == math.inf
    other = AxisMeter(Accuracy(counts_losses=False, largest_speed=0.5))
    other.leave_open(2.0, 3, 1e-4)
    assert other.resolution == 0.0


def test_no_motion_within_the_error_of_every_position_goes_less_far_than_what_friction_is_counted_for() -> None:
    """Searched among whole places within two of every position, from any of those at the first."""
    for seed in range(40):
        draw = random.Random(seed)
        places = [draw.randint(-3, 3)]
        for _ in range(10):
            places.append(places[-1] + draw.randint(-6, 6))
        least = dict.fromkeys(range(places[0] - 2, places[0] + 3), 0)
        meter = AxisMeter(Accuracy(position=2.0, device_friction=0.5))
        for at, place in enumerate(places):
            meter.take(place, 0.0, at, touches=False)
            within = range(place - 2, place + 3)
            least = {end: min(way + abs(end - start) for start, way in least.items()) for end in within}
            assert meter.dissipated == 0.5 * min(least.values())


@pytest.mark.parametrize(("damping", "friction"), [(None, None), (0.0, None), (None, 0.0), (1.0, 1.0)])
def test_a_device_is_damped_as_soon_as_anything_of_it_is_declared(
    damping: float | None, friction: float | None
) -> None:
    meter = AxisMeter(Accuracy(device_damping=damping, device_friction=friction))
    assert meter.is_damped is (damping is not None or friction is not None)


def test_what_was_asked_for_is_the_effort_of_the_wall_at_the_position_in_contact_alone() -> None:
    meter = AxisMeter(environment=SpringDamperWall(stiffness=500.0, damping=7.0, position=0.0))
    assert meter.damping_asked == 7.0
    asked = []
    for at, (place, touches) in enumerate([(1e-3, True), (-2e-3, True), (-2e-3, False), (-1e-3, True)]):
        meter.take(place, 0.0, at, touches=touches)
        asked.append(abs(meter.asked))
    assert asked == pytest.approx([0.0, 1.0, 0.0, 0.5])
    assert AxisMeter().damping_asked == 0.0


def test_the_friction_that_is_declared_is_compared_with_every_hold_that_the_meter_takes() -> None:
    wall = SpringDamperWall(stiffness=500.0, damping=0.0, position=0.0)
    declared = FrictionDeclared(0.5, 0.25, T, 0.0)
    alone, watch = FrictionWatch(declared), FrictionWatch(declared)
    meter, position = AxisMeter(Accuracy(device_friction=0.5), wall, watch), -0.02
    for at in range(60):
        torque = 0.1 * (at % 2)
        meter.take(position, torque, at, touches=True)
        alone.take(position, torque, at, 500.0 * position)
        position += T * (0.0 if at < 20 else 0.2)
    assert watch.excess == pytest.approx(alone.excess)
    assert watch.excess > 0.1


def test_a_silent_meter_knows_the_position_alone() -> None:
    meter = SilentMeter()
    meter.leave_open(1.0, 1, 1.0)
    meter.take(0.5, 1.0, 0, touches=True)
    meter.take(0.7, 2.0, 1, touches=True)
    assert (meter.position, meter.resolution, meter.dissipated) == (0.7, 0.0, 0.0)


def test_an_accuracy_that_declares_nothing_leaves_nothing_open_but_the_dissipation() -> None:
    ideal = Accuracy()
    assert (ideal.sample_time, ideal.position, ideal.torque_share, ideal.torque_offset) == (1e-3, 0.0, 0.0, 0.0)
    assert (ideal.late, ideal.late_speed, ideal.device_damping, ideal.device_friction) == (0.0, None, None, None)
    assert not ideal.is_estimate
    assert ideal.most_dissipated == math.inf
    meter = AxisMeter()
    assert not meter.is_damped
    for at, place in enumerate((0.0, 1e-3, 5e-3, -2e-3)):
        meter.take(place, 3.0 * at, at, touches=True)
    assert (meter.resolution, meter.dissipated, meter.asked) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("late", "speed", "is_estimate"), [(1e-4, None, True), (1e-4, 0.4, False), (0.0, None, False)])
def test_lateness_is_an_estimate_where_no_speed_bounds_it(late: float, speed: float | None, is_estimate: bool) -> None:
    assert Accuracy(late=late, late_speed=speed).is_estimate is is_estimate


def test_a_device_dissipates_at_most_its_bounds_at_the_largest_speed() -> None:
    known: dict[str, Any] = {"device_damping_bound": 2.0, "device_friction_bound": 3.0, "largest_speed": 0.5}
    assert Accuracy(**known).most_dissipated == pytest.approx((2.0 * 0.5 + 3.0) * 0.5)
    for missing in known:
        assert Accuracy(**{key: value for key, value in known.items() if key != missing}).most_dissipated == math.inf


def test_a_silent_meter_books_the_least_and_gives_its_motion_to_the_fit() -> None:
    taken: list[tuple[float, float, int]] = []
    felt = SimpleNamespace(take=lambda *hold: taken.append(hold))
    meter = SilentMeter(felt)  # type: ignore[arg-type]
    meter.take(0.5, 1.0, 3, touches=False)
    assert (meter.felt, taken) == (felt, [(0.5, 1.0, 3)])
    assert (SilentMeter.books_least, AxisMeter.books_least, AxisMeter.felt) == (True, False, None)


@pytest.mark.parametrize("open_time", [0, 1])
def test_what_an_algorithm_takes_off_for_a_lost_sample_is_uncertain_in_however_few_holds(open_time: int) -> None:
    """It counts a hold for each SYNC; where both were of one hold, the torque read back leaves no sample time open."""
    wall = SpringDamperWall(stiffness=1000.0)
    controller = Unprotected(wall, Unprotected.parameters_type(), LoopProperties(sample_time=T, delay=1))
    drive: Any = SimpleNamespace(read_back_bound=0.0, longest_hold=1, uncommanded=0, open_time=None, open_torque=0.0)
    port = AxisPort(AxisMeter(Accuracy(sample_time=T)), drive, controller)
    true = last = 0.0
    for row, (position, torque, is_lost) in enumerate(
        [(0.0, 0.0, False), (-1e-3, 0.0, False), (-3e-3, 0.0, False), (-3e-3, 0.0, True), (-4e-3, 1.5, False)]
    ):
        balance = controller.sample_lost() if is_lost else controller.step(position, torque)
        port.ledger.add(balance, row, row)
        drive.open_time = open_time if row == 4 else None
        port.take(Sample(row, position, torque, 0, fresh=not is_lost), balance, row)
        true, last = true - torque * (position - last), position
    error = abs(port.ledger.interaction - true)
    assert error > 1e-3
    assert port.measured().energy_resolution == pytest.approx(error, rel=1e-12)

from typing import NamedTuple

import numpy as np
import pytest

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.direct_rig import DirectRig
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters

MS = 1_000_000


class Command(NamedTuple):
    torque: float


def spring(position: float, torque_applied: float) -> Command:
    return Command(-100.0 * min(position, 0.0))


def plant_with_hand() -> Plant:
    motion = SinusoidMotion(amplitude=0.03, frequency=1.0, phase=3.0)
    return Plant(PlantParameters(mass=0.25), UserParameters(stiffness=300, damping=3, motion=motion), (), MS)


@pytest.mark.parametrize("delay", [0, 1])
def test_a_torque_acts_after_its_delay(delay):
    record = DirectRig(plant_with_hand(), spring, MS, delay).run(400)
    assert np.any(record.torque_command)
    assert np.array_equal(record.torque_applied[1 + delay :], record.torque_command[: -1 - delay])
    assert not np.any(record.torque_applied[: 1 + delay])


def test_the_motor_work_is_the_sum_of_torque_times_displacement():
    record = DirectRig(plant_with_hand(), spring, MS).run(400)
    work = np.sum(record.torque_applied[1:] * np.diff(record.true_position))
    assert record.energy.motor == pytest.approx(work, rel=1e-12)


def test_counts_and_torque_quantum_are_those_of_the_bus():
    record = DirectRig(plant_with_hand(), spring, MS, 0, counts_per_unit=1e5, torque_quantum=0.01).run(400)
    assert np.all(np.abs(record.position - record.true_position) <= 0.5e-5 * (1 + 1e-9))
    assert np.array_equal(record.position, np.round(record.position * 1e5) * (1 / 1e5))
    assert np.array_equal(record.torque_applied, np.round(record.torque_applied / 0.01) * 0.01)


def test_the_torque_is_limited_on_both_sides_before_it_is_rounded():
    free = DirectRig(plant_with_hand(), spring, MS).run(400)
    limit = 0.5 * float(np.abs(free.torque_command).max())
    record = DirectRig(plant_with_hand(), spring, MS, torque_limit=limit).run(400)
    assert float(np.abs(record.torque_command).max()) == limit
    assert float(np.abs(record.torque_applied).max()) == limit
    begin = int(np.argmax(np.abs(free.torque_command) > limit))
    assert np.array_equal(record.position[: begin + 1], free.position[: begin + 1])
    broken = DirectRig(plant_with_hand(), lambda _q, _held: HasNoTorque(), MS, torque_limit=limit).run(1)
    assert np.isnan(broken.torque_command[0])  # no number is not made one


class HasNoTorque:
    torque = float("nan")


@pytest.mark.parametrize(
    "values", [{"delay": 2}, {"counts_per_unit": 0.0}, {"torque_quantum": -1.0}, {"torque_limit": 0.0}]
)
def test_bad_settings_are_refused_by_name(values):
    with pytest.raises(ParameterError, match=next(iter(values))):
        DirectRig(plant_with_hand(), spring, MS, **values)

"""Over the bus, in lock-step, the motor goes through the same floats as without a bus."""

import struct
from typing import NamedTuple

import pytest

from canhaptic.sim.plant.direct_rig import DirectRig
from canhaptic.sim.plant.plant import Plant, PlantParameters
from tests.sim_drive.drive_on_bus import PERIOD, Rig

QUANTUM = 0.01  # [N] of 10 N rated
CYCLES = 200


class Push(NamedTuple):
    torque: float


def wall(position: float) -> float:
    return -200.0 * position if position < 0.0 else 0.0


def moving_mass() -> Plant:
    return Plant(PlantParameters(mass=0.5, initial_velocity=-0.05), None, (), PERIOD)


@pytest.mark.parametrize("delay", [0, 1])
def test_motor_behind_the_bus_moves_bit_for_bit_as_the_motor_without(delay: int) -> None:
    direct = DirectRig(moving_mass(), lambda q, _: Push(wall(q)), PERIOD, delay, 1e6, QUANTUM).run(CYCLES)
    motor = moving_mass()
    with Rig(motor=motor, rated_torque=10.0) as rig:  # type: ignore[arg-type]
        assert rig.write(0x1400, 2, delay or 255, 1) == "ok"
        rig.enable()
        if motor._epoch is None:
            rig.sync()  # the synchronous controlword acts one SYNC later
        for k in range(CYCLES):
            if k:
                ((_, frame),) = rig.sync()
                counts, demand = struct.unpack("<ih", bytes.fromhex(frame)[2:])
                assert counts == round(direct.position[k] * 1e6)
                assert demand == round(direct.torque_applied[k] / QUANTUM)
            assert rig.drive.truth().position == direct.true_position[k]
            target = round(wall(direct.position[k]) / QUANTUM)
            rig.send(0x205, "0f00" + struct.pack("<h", target).hex())
        assert direct.torque_applied.max() > 0.4
        assert rig.drive.truth().energy == direct.energy

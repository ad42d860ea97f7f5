import math
from pathlib import Path

import h5py

from canhaptic.audit import recompute as module
from canhaptic.audit.recompute import recompute
from canhaptic.control.balance import EnergyBalance
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties, build_controller
from canhaptic.control.ports import Ports, axis_ports
from canhaptic.logs.columns import PortDescription
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.writer_process import EnergyLogWriter
from canhaptic.signals import CycleTiming, Sample


class WithHold:
    """The controller under test; a lost sample repeats the last balance."""

    def __init__(self) -> None:
        wall = SpringDamperWall(stiffness=800.0, damping=4.0)
        self._inner = build_controller(wall, "internal_dissipation", None, LoopProperties(sample_time=1e-3))
        self.reset = self._inner.reset

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        self._last = self._inner.step(position, torque_applied)
        return self._last

    def sample_lost(self) -> EnergyBalance:
        return self._last


def record(path: Path) -> None:
    controller = WithHold()
    writer = EnergyLogWriter(path, [PortDescription("handle", "m")], {}, sample_time_ns=1_000_000, pace="free")
    torque = 0.0
    for k in range(1000):
        sample = Sample(k, 0.02 * math.cos(0.01 * k), torque, 0x1237, k % 50 != 7)
        balance = controller.step(sample.position, torque) if sample.fresh else controller.sample_lost()
        writer.append(k, [sample], [balance], CycleTiming(0, 0, 0, 0))
        torque = balance.torque
    writer.close()


def test_a_recorded_run_is_reproduced_bit_for_bit_and_one_changed_bit_is_found(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(module, "_BLOCK", 300)
    path = tmp_path / "run.h5"
    record(path)
    with EnergyLog.open(path) as log:
        assert log.ports["handle"]["torque_command"].max() > 1.0
        assert recompute(log, ["handle"], Ports(axis_ports([WithHold()]))) == []
    with h5py.File(path, "r+") as file:
        file["ports/handle/h_s"][321] = math.nextafter(file["ports/handle/h_s"][321], math.inf)
    with EnergyLog.open(path) as log:
        [found] = recompute(log, ["handle"], Ports(axis_ports([WithHold()])))
    assert found[:3] == ("handle", 321, "stored")
    assert math.nextafter(found.recomputed, math.inf) == found.logged

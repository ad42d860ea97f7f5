"""Axes that render together and axes that render alone: who gets which sample, torque and part of the energy."""

from collections.abc import Sequence

import pytest

from canhaptic.control.balance import AT_REST, Branch, EnergyBalance, GroupBalance
from canhaptic.control.energy_audit import EnergyAudit
from canhaptic.control.ledger import Ledger
from canhaptic.control.mechanisms.kinematics import Limit
from canhaptic.control.multi_axis.group_controller import AxisGroup
from canhaptic.control.ports import Port, Ports
from canhaptic.signals import PlantEnergy, Sample, Truth


class Group:
    """Torque i is ten times the position of axis i; its part is minus torque applied times position."""

    axes = 2

    def __init__(self) -> None:
        self.limit = 0
        self.held = 0

    def reset(self) -> None:
        pass

    def step(self, positions: Sequence[float], torques_applied: Sequence[float]) -> GroupBalance:
        parts = tuple(-t * p for t, p in zip(torques_applied, positions, strict=True))
        account = AT_REST._replace(h_i=sum(parts), h_s=sum(parts), branch=Branch.EXACT.value, certificate=2)
        return GroupBalance(tuple(10.0 * p for p in positions), account, parts, limit=self.limit)

    def sample_lost(self) -> GroupBalance:
        self.held += 1
        return GroupBalance((7.0, 8.0), AT_REST._replace(branch=Branch.HELD.value), (0.0, 0.0))


class Alone:
    def reset(self) -> None:
        pass

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        return AT_REST._replace(torque=-position, h_i=torque_applied)

    def sample_lost(self) -> EnergyBalance:
        return AT_REST._replace(torque=99.0)


def sample(position: float, torque: float = 0.0, fresh: bool = True, word: int = 0x27) -> Sample:
    return Sample(4, position, torque, word, fresh)


def test_each_axis_gets_its_own_whatever_the_order_of_the_group() -> None:
    ports = Ports([Port("alone", (1,), 1, Alone()), AxisGroup("pair", (2, 0), 3, Group())])
    *balances, account = ports.balances_of([sample(1.0, 0.5), sample(2.0, 0.25), sample(3.0, -0.5)])
    assert [b.torque for b in balances] == [10.0, -2.0, 30.0]
    assert [b.h_i for b in balances] == [-0.5, 0.25, 1.5]
    assert [b.branch for b in balances] == [Branch.GROUP, Branch.FREE, Branch.GROUP]
    assert [b.certificate for b in balances] == [2, 0, 2]
    assert account.h_i == 1.0


@pytest.mark.parametrize("lost", [0, 2])
def test_the_whole_group_holds_when_one_of_its_samples_is_lost_and_others_go_on(lost: int) -> None:
    group = AxisGroup("pair", (0, 2), 3, Group())
    ports = Ports([Port("alone", (1,), 1, Alone()), group])
    samples = [sample(1.0), sample(2.0), sample(3.0)]
    samples[lost] = samples[lost]._replace(fresh=False)
    *balances, account = ports.balances_of(samples)
    assert [b.torque for b in balances] == [7.0, -2.0, 8.0]
    assert [b.branch for b in (*balances, account)] == [Branch.HELD, Branch.FREE, Branch.HELD, Branch.HELD]
    assert not group.sample(samples).fresh
    alone_lost = [sample(1.0), sample(2.0, fresh=False), sample(3.0)]
    assert [b.torque for b in ports.balances_of(alone_lost)[:3]] == [10.0, 99.0, 30.0]


def test_a_limit_is_counted_every_hold_and_told_once() -> None:
    inner = Group()
    group, told = AxisGroup("pair", (0, 1), 2, inner), []
    for limit in (0, Limit.SINGULAR, Limit.SINGULAR, 0, Limit.SINGULAR, Limit.WORKSPACE):
        inner.limit = int(limit)
        group.step([sample(1.0), sample(2.0)], [AT_REST] * 3)
        told.append(group.news[:8])
    assert told == ["", "the pose", "", "", "the pose", "the mech"]
    assert group.limits == {"workspace": 1, "singular": 3, "unsolved": 0}


def test_the_row_of_a_group_has_the_norm_of_its_torques_and_every_bit_of_its_axes() -> None:
    group = AxisGroup("pair", (0, 2), 3, Group())
    row = group.sample([sample(1.0, 3.0, word=0x27), sample(9.0, 9.0, word=0xFFFF), sample(2.0, 4.0, word=0x827)])
    assert row == Sample(4, 0.0, 5.0, 0x827, True)


def test_the_true_energies_of_a_group_are_those_of_its_axes_and_of_a_mover() -> None:
    ports, ledgers = Ports([Port("alone", (1,), 1, Alone()), AxisGroup("pair", (0, 2), 3, Group())]), [Ledger()] * 3
    truths = [Truth(0.1 * i, PlantEnergy(1.0 * i, 2.0, 3.0, 4.0)) for i in range(3)]
    account = Ledger()
    account.add(AT_REST._replace(supplied=0.5, h_i=0.5, h_dis=0.5, h_s=0.5), 0)
    audit = EnergyAudit(ports)
    *own, found = audit.compare([*ledgers, account], truths, [AT_REST] * 4)
    assert own == truths
    assert found == Truth(0.0, PlantEnergy(1.5, 4.0, 6.0, 8.0))
    assert (audit.interaction[3], audit.dissipated[3]) == (-1.5, 6.0)

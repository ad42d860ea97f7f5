"""What `canhaptic.drive.profile.scaling` must do: values by hand, and where a torque is rounded to."""

import math
from pathlib import Path
from types import ModuleType

import pytest

from canhaptic.drive.axis_parameters import AxisParameters
from canhaptic.errors import ParameterError

INT16 = 32_767
ROUNDED = (
    # torque, low, high [per mille of 1 N*m], what is sent
    (300.5, -1e9, 1e9, 300),
    (300.6, -1e9, 1e9, 301),
    (300.4, -1e9, 1e9, 300),
    (300.6, -300.6, 300.6, 300),
    (300.4, -300.4, 300.4, 300),
    (-300.6, -300.6, 300.6, -300),
    (-300.6, -1e9, 0.0, -301),
    (300.6, 0.0, 300.7, 300),
    (0.6, 0.0, 0.6, 0),
    (0.0, 0.0, 0.0, 0),
    (INT16, -INT16, INT16, INT16),
    (-INT16, -INT16, INT16, -INT16),
)


def judge(module: ModuleType) -> None:
    """Raises when the module does not convert."""
    _positions(module)
    _torques(module)
    _axes(module)
    for rated in (7.3, 1.27, 0.11):
        limits = [n / 1000.0 * rated for n in (*range(60), 999, 1000, 1001, 1999)]
        assert [module.torque_limit_per_mille(limit, rated) for limit in limits] == [*range(60), 999, 1000, 1001, 1999]
        beyond = [(n + 0.999) / 1000.0 * rated for n in range(60)]
        assert [module.torque_limit_per_mille(limit, rated) for limit in beyond] == list(range(60))
        scaling = module.AxisScaling(1.0, rated)
        assert [scaling.torque_per_mille(limit, -limit, limit) for limit in limits[:60]] == list(range(60))
    for place, wrong in ((place, wrong) for place in (0, 1) for wrong in (0.0, -0.5, math.nan, math.inf)):
        with pytest.raises(ParameterError, match=f"{('counts_per_unit', 'rated_torque')[place]}: got {wrong},"):
            module.AxisScaling(*((wrong, 0.5) if place == 0 else (0.5, wrong)))


def _positions(module: ModuleType) -> None:
    for direction in (1, -1):
        scaling = module.AxisScaling(8.0, 1.0, direction)
        wrapped = (2**31 - 1, -(2**31), 2**31 - 1, 0, -(2**31), -(2**31) - 1 + 2**32, -16)
        true = (2**31 - 1, 2**31, 2**31 - 1, 0, -(2**31), -(2**31) - 1, -16)
        assert [scaling.position(counts) for counts in wrapped] == [direction * count / 8.0 for count in true]
        for counts in (-(2**31), 2**31 - 1, -16):
            scaling.reset()
            assert scaling.position(counts) == direction * counts / 8.0
        scaling.reset()
        half_way = [scaling.position(counts) for counts in (-1, 2**31 - 1)]  # half the range is a step down
        assert half_way == [direction * count / 8.0 for count in (-1, -(2**31) - 1)]


def _axes(module: ModuleType) -> None:
    """An axis of 8 counts per metre and 2.5 N rated, whose drive counts torque in per mille, per cent, per 10 000."""
    for quirks, counts in (((), 1000), (("torque_per_cent",), 100), (("torque_per_ten_thousand",), 10_000)):
        for direction in (1, -1):
            axis = AxisParameters(
                name="a", node_id=1, eds=Path("a.eds"), counts_per_unit=8.0, torque_limit=1.0, direction=direction,
                quirks=quirks,
            )  # fmt: skip
            scaling = module.axis_scaling(axis, 2.5)
            assert scaling.position(16) == 2.0 * direction
            assert scaling.torque(counts) == pytest.approx(2.5 * direction, rel=1e-15)


def _torques(module: ModuleType) -> None:
    for direction, quantum in ((1, 1.0), (-1, 1.0), (1, 0.5), (-1, 4.0)):
        scaling = module.AxisScaling(1.0, 1000.0 * quantum, direction)
        assert scaling.rated_torque == 1000.0 * quantum
        assert (scaling.torque_quantum, scaling.largest_torque) == (quantum, INT16 * quantum)
        assert [scaling.torque(counts) for counts in (-3, 0, 7)] == [c * quantum * direction for c in (-3, 0, 7)]
        for torque, low, high, sent in ROUNDED:
            assert scaling.torque_per_mille(torque * quantum, low * quantum, high * quantum) == sent * direction
    assert module.AxisScaling(1.0, 2.5).torque(1000) == 2.5
    assert module.AxisScaling(1.0, 2.5).torque_per_mille(2.5, -9.0, 9.0) == 1000
    for n in (1, 300, 32767):  # a hair below a whole number is that number, two hairs are not
        assert module.torque_limit_per_mille(n - 0.5e-9, 1000.0) == n
        assert module.torque_limit_per_mille(n - 1.5e-9, 1000.0) == n - 1

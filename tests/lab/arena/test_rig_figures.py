"""What the arena measures on its rig: theory is that of the books, and what is measured lies where it must."""

import numpy as np
import pytest

from canhaptic.files import shipped
from canhaptic.lab.studies import arena
from canhaptic.lab.studies.arena import DAMPINGS, borders, impedances, mass_widths, on_rig, theory, tried_stiffnesses

RIG = shipped("configs") / "arena_rig.yaml"


@pytest.mark.slow
def test_the_lines_of_theory_begin_where_the_books_say() -> None:
    for delay, colgate in ((0, 200.0), (1, 200.0 / 3.0)):  # 2 b / T, and a third of it one sample late
        found = theory(RIG, delay)
        assert found["Colgate, plain wall"][0] == {"damping": 0.0, "stiffness": pytest.approx(colgate, rel=1e-3)}
        assert max(point["damping"] for point in found["Colgate, plain wall"]) < 0.1  # the damping of the device
        stable = {point["damping"]: point["stiffness"] for point in found["eigenvalues, plain wall"]}
        assert set(stable) > set(DAMPINGS)
        assert stable[0.0] > 10.0 * colgate  # the hand of the rig holds much more than every hand would
        assert found["largest certificate of guarded"][0]["stiffness"] > stable[0.0]


@pytest.mark.slow
def test_the_plain_wall_is_late_by_half_a_hold_and_a_whole_one_of_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arena, "FREQUENCIES", (5.0, 20.0))
    for delay in (0, 1):
        for found in impedances(on_rig(RIG, "unprotected", delay)):
            lag = 2.0 * np.pi * found["frequency"] * (0.5 + delay) * 1e-3
            assert found["size"] == pytest.approx(1.0, abs=0.04)
            assert found["angle"] == pytest.approx(-lag, abs=0.02)


@pytest.mark.slow
def test_the_m_width_of_the_rig_hardly_depends_on_the_rate() -> None:
    found = mass_widths(RIG)
    assert {row["delay"] for row in found} == {0, 1}
    assert all(row["most"] == pytest.approx(0.5 if row["delay"] == 0 else 0.309, rel=2e-3) for row in found)
    assert all(row["least"] == pytest.approx(-0.25, rel=6e-3) for row in found)


@pytest.mark.slow  # 200,000 cycles
def test_the_plain_wall_ends_between_colgates_line_and_its_eigenvalues() -> None:
    plain = {row["damping"]: row for row in borders(on_rig(RIG, "unprotected", 0), 2)}
    stable = {point["damping"]: point["stiffness"] for point in theory(RIG, 0)["eigenvalues, plain wall"]}
    step = tried_stiffnesses(2)[1] / tried_stiffnesses(2)[0]
    assert plain[0.0]["passive"] >= 200.0 / step
    for damping, row in plain.items():
        assert row["near"] <= row["passive"] <= 1.1 * stable[damping]
        assert not row["open"]

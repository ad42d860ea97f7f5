"""The scale of the torque: verified by the mass, a balance or a weight; a wrong one is caught with little torque."""

import struct
from pathlib import Path

import can
import pytest

from canhaptic.commission.sequence import commission
from canhaptic.commission.session import CommissioningLimits, Guard, Report, Session, StepVerdict, Unattended
from canhaptic.commission.torque_tests import RisingTorque
from canhaptic.scene.load import load_scene

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
DRY = "simulation.effects=[{type: coulomb_friction, kinetic: 0.05 N, static: 0.06 N}]"
NAME_PLATE = ("axes.0.rated_torque=5 N", "axes.0.quirks=[rated_torque_absent]", "simulation.drive.rated_torque=10 N")
"""The drive gives 10 N at 1000 per mille, and does not say so."""


class Answers(Unattended):
    """A twin that names another means than it would by itself, and what its weight weighs."""

    def __init__(self, means: str, weight: float | None = None) -> None:
        super().__init__(self._keep)
        self.said: list[str] = []
        self._means, self._weight = means, weight

    def _keep(self, text: str) -> None:
        self.said.append(text)

    def choose(self, question: str, answers: object, truth: str) -> str:
        return self._means or truth

    def number(self, question: str, unit: str, truth: float | None) -> float | None:
        return self._weight if "weight" in question else super().number(question, unit, truth)


def report_of(*overrides: str, means: str = "", weight: float | None = None) -> tuple[Report, list[int], list[str]]:
    """Report, target torques on the bus [per mille], and what was said."""
    channel = f"scale-{hash((overrides, means))}"
    answers = Answers(means, weight)
    with can.Bus(interface="virtual", channel=channel) as bus:
        scene = load_scene(DEMO, [*overrides, f"bus.channel={channel}"])
        session = Session(scene, answers, CommissioningLimits(), lambda: False)
        commission(session, 0.05)
        frames = list(iter(lambda: bus.recv(0.0), None))
    sent = [struct.unpack("<h", frame.data[2:4])[0] for frame in frames if frame.arbitration_id == 0x201]
    return session.report, sent, answers.said


def found(report: Report) -> tuple[str, StepVerdict]:
    """What the report says of the scale of the torque."""
    [row] = [row for row in report.findings if row.item == "torque scale"]
    return row.found, row.verdict


def verified_by(report: Report) -> list[object]:
    return [value.value for value in report.values if value.key == "torque_verified"]


@pytest.mark.slow
@pytest.mark.parametrize("means", ["mass", "balance"])
def test_a_wrong_rated_torque_is_caught_with_one_per_cent_of_the_true_one(means: str) -> None:
    report, sent, _ = report_of(*NAME_PLATE, means=means)
    ratio, verdict = found(report)
    assert float(ratio) == pytest.approx(2.0, rel=0.05)
    assert verdict is StepVerdict.DIFFERS
    assert verified_by(report) == []
    [proposed] = [value.value for value in report.values if value.key == "rated_torque"]
    assert proposed == pytest.approx(10.0, rel=0.05)
    assert 0 < max(map(abs, sent)) <= 10
    assert "handle: moving mass: not verified" in report.unfinished(["handle"], ["moving mass"])


@pytest.mark.slow
def test_behind_dry_friction_a_twin_is_read_by_its_balance() -> None:
    report, _, said = report_of(DRY)
    assert found(report) == ("1", StepVerdict.AGREES)
    assert verified_by(report) == ["balance"]
    assert any("balance" in text and "per mille" in text for text in said)


@pytest.mark.slow
@pytest.mark.parametrize(("rated", "verdict"), [((), StepVerdict.AGREES), (NAME_PLATE, StepVerdict.DIFFERS)])
def test_a_weight_on_its_support_is_lifted_and_let_down(rated: tuple[str, ...], verdict: StepVerdict) -> None:
    """Dry friction adds to the weight on its way up, and takes from it on its way down."""
    support = "{type: hard_stop, side: lower, position: 0, stiffness: 1e5 N/m, damping: 300 N*s/m}"
    dry = "{type: coulomb_friction, kinetic: 0.1 N, static: 0.12 N}"
    plant = ("simulation.user={push: -0.6 N}", f"simulation.effects=[{support}, {dry}]")
    report, _, _ = report_of(*rated, *plant, "axes.0.torque_limit=4 N", means="weight", weight=0.6)
    ratio, seen = found(report)
    assert seen is verdict
    assert float(ratio) == pytest.approx(2.0 if rated else 1.0, rel=0.08)


@pytest.mark.slow
def test_without_a_means_no_more_torque_is_sent_and_nothing_is_finished() -> None:
    report, sent, _ = report_of(means="no")
    assert found(report)[1] is StepVerdict.UNKNOWN
    assert verified_by(report) == []
    assert 0 < max(map(abs, sent)) <= 20  # the pulses alone
    assert report.unfinished(["handle"], ["torque scale"]) == ["handle: torque scale: not verified"]


def test_a_rising_torque_ends_at_zero_where_the_axis_goes_too_far_or_nothing_is_lifted() -> None:
    for positions, end in (([0.0] * 99, ""), ([0.0, 0.5, 0.5], "moved further")):
        law = RisingTorque(0.1, 0.3, 2, Guard(0.2, 10.0), 0.1, lifts=True)
        torques = [law.step(position, 0.0).torque for position in positions]
        assert max(torques) <= 0.3
        assert torques[-1] == 0.0
        assert law.has_ended
        assert law.tripped.startswith(end)

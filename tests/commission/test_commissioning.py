"""Commissioning of simulated drives, each wrong in one way; judged by the report and by the frames."""

import re
import struct
from collections.abc import Callable, Sequence
from functools import cache

import can
import pytest

from canhaptic.commission import mass_and_friction
from canhaptic.commission.sequence import STANDSTILL, _scan, commission, pull_the_master, stand_still
from canhaptic.commission.session import (
    CommissioningLimits,
    Report,
    Session,
    StepFinding,
    StepVerdict,
    Unattended,
    Value,
)
from canhaptic.commission.torque_sign import pulse
from canhaptic.drive.can.link import Link
from canhaptic.drive.clock import VirtualClock
from canhaptic.errors import InputError, StartError
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import TO_SET
from tests.commission.whole_session import DEMO, whole_session

CONFIGS = DEMO.parent
TIMED = 0.2  # [s]


MOVES = "Pulses of|Doublets of|A sweep of|A shake of|Reversals of"
"""What need not be measured where the watchdog is looked at."""


class Answers(Unattended):
    """Agrees to everything but the questions in which a pattern is found."""

    def __init__(self, refused: str = "") -> None:
        self.said: list[str] = []
        super().__init__(self.said.append)
        self.refused = refused

    def confirm(self, question: str) -> bool:
        return super().confirm(question) and not (self.refused and re.search(self.refused, question))


def commissioned(
    *overrides: str,
    limits: CommissioningLimits | None = None,
    refused: str = "",
    stop: Callable[[], bool] | None = None,
    until: str = "",
) -> Report:
    """The report of one session, up to an item."""

    def is_over() -> bool:
        return stop() if stop else any(finding.item == until for finding in session.report.findings)

    scene = load_scene(DEMO, list(overrides))
    session = Session(scene, Answers(refused), limits or CommissioningLimits(), is_over)
    commission(session, TIMED)
    return session.report


def row(report: Report, item: str) -> StepFinding:
    [found] = [finding for finding in report.findings if finding.item == item]
    return found


def value(report: Report, key: str) -> float | int | str:
    [found] = [v.value for v in report.values if v.key == key]
    assert found is not None
    return found


def frames_of(run: Callable[[str], object], channel: str) -> list[can.Message]:
    """Everything on a virtual channel while `run` runs."""
    with can.Bus(interface="virtual", channel=channel, preserve_timestamps=True) as bus:
        run(f"bus.channel={channel}")
        return list(iter(lambda: bus.recv(0.0), None))


def torques(frames: Sequence[can.Message]) -> list[int]:
    """Target torques of every RPDO1: controlword, target torque [per mille]."""
    return [struct.unpack("<h", frame.data[2:4])[0] for frame in frames if frame.arbitration_id == 0x201]


@cache
def turned(wrong: str) -> tuple[Report, list[can.Message]]:
    """The session of a drive of which one direction is reversed, and its frames."""
    reports: list[Report] = []
    frames = frames_of(lambda at: reports.append(commissioned(at, f"simulation.drive.reversed={wrong}")), "turned")
    return reports[0], frames


def test_a_handle_that_was_too_fast_gets_half_the_torque_the_next_time_and_no_frame_carries_more() -> None:
    laws, said = [], Answers()

    def played(at: str) -> None:
        session = Session(load_scene(DEMO, [at]), said, CommissioningLimits(speed=8e-3), lambda: False)
        with session.rig_of(with_hand=False):
            laws.append(session.play_within(0, "a test", lambda torque: [torque] * 20 + [-torque] * 20, 0.2))

    frames = frames_of(played, "halved")
    assert not laws[0].tripped
    assert max(laws[0].applied) == pytest.approx(0.05, abs=0.005)  # 5 mm/s after 20 ms of 0.25 kg
    assert max(map(abs, torques(frames))) == 20  # 0.2 N, per mille of the rated torque
    assert [line.rsplit(" ", 2)[1] for line in said.said if "repeating with" in line] == ["0.1", "0.05"]


@pytest.mark.slow
def test_a_right_configuration_agrees_in_everything_and_no_torque_exceeds_what_was_announced() -> None:
    report, (missing, error), frames = whole_session()
    assert (missing, error) == ([], None)
    assert max(abs(torque) for torque in torques(frames)) in range(50, 101)  # 10 per cent of the rated torque
    assert not report.failed
    assert not report.differs
    assert row(report, "moving mass").found.startswith("0.25")
    assert value(report, "passivity.moving_mass") == pytest.approx(0.225, rel=0.01)  # 0.9 of 0.25 kg
    assert row(report, "watchdog").verdict is StepVerdict.AGREES
    assert row(report, "cycle").verdict is StepVerdict.AGREES


@pytest.mark.slow
def test_wrong_encoder_counts_are_found_and_do_not_spoil_mass_and_scale() -> None:
    report = commissioned("simulation.drive.counts_per_unit=5e5", until="moving mass")
    assert row(report, "encoder counts").verdict is StepVerdict.DIFFERS
    assert value(report, "counts_per_unit") == pytest.approx(5e5, rel=1e-4)
    assert float(row(report, "moving mass").found.removesuffix(" kg")) == pytest.approx(0.25, rel=1e-3)
    assert row(report, "torque scale").verdict is StepVerdict.AGREES


@pytest.mark.slow
def test_a_drive_mounted_the_other_way_round_wants_direction_minus_one() -> None:
    report = commissioned("simulation.drive.direction=-1")
    assert row(report, "encoder direction").verdict is StepVerdict.DIFFERS
    assert value(report, "direction") == -1
    assert row(report, "torque sign").verdict is StepVerdict.AGREES
    assert not commissioned("simulation.drive.direction=-1", "axes.0.direction=-1").differs  # what it says, helps


@pytest.mark.slow_but("torque")
@pytest.mark.parametrize("wrong", ["torque", "encoder"])
def test_a_motor_that_turns_against_its_encoder_gets_no_more_torque(wrong: str) -> None:
    report, _ = turned(wrong)
    assert row(report, "torque sign").verdict is StepVerdict.FAILED
    assert not [finding for finding in report.findings if finding.item == "moving mass"]
    assert report.failed


@pytest.mark.slow
def test_a_rated_torque_that_the_drive_does_not_have_is_found_by_a_known_mass() -> None:
    report = commissioned(
        "axes.0.quirks=[rated_torque_absent]",
        "simulation.drive.absent=[0x6076]",
        "axes.0.rated_torque=5 N",
        "simulation.drive.rated_torque=10 N",
    )
    assert row(report, "rated torque (0x6076)").verdict is StepVerdict.UNKNOWN
    assert row(report, "torque scale").verdict is StepVerdict.DIFFERS
    assert value(report, "rated_torque") == pytest.approx(10.0, rel=0.01)


@pytest.mark.slow
def test_a_drive_that_reports_its_torque_after_the_update_is_told_from_one_that_does_before() -> None:
    assert row(commissioned(), "read-back to motion").verdict is StepVerdict.AGREES
    report = commissioned("simulation.drive.torque_read_back=after_update")
    assert row(report, "command to motion").verdict is StepVerdict.AGREES
    assert row(report, "read-back to motion").verdict is StepVerdict.DIFFERS
    assert value(report, "demand_reported") == "after"
    assert not commissioned("simulation.drive.torque_read_back=after_update", "axes.0.demand_reported=after").differs


SHAFT = "simulation.effects=[{{type: shaft_compliance, stiffness: {} N/m, damping: 2 N*s/m, load_mass: 0.15 kg}}]"


@pytest.mark.slow
def test_behind_a_compliant_shaft_the_mass_of_the_rotor_is_proposed() -> None:
    """The rotor has 0.25 kg, rotor and load 0.4 kg: declared for them, energy comes out of a certified wall."""
    report = commissioned(SHAFT.format(5000))
    assert row(report, "compliant shaft").verdict is StepVerdict.MEASURED
    assert 0.12 < float(value(report, "passivity.moving_mass")) < 0.25
    assert row(commissioned(SHAFT.format(5000), "passivity.moving_mass=0.3 kg"), "moving mass").verdict is (
        StepVerdict.FAILED
    )


@pytest.mark.slow
def test_near_a_resonance_no_mass_is_proposed_and_none_is_seen_on_a_rigid_axis() -> None:
    report = commissioned(SHAFT.format(50_000))
    assert row(report, "compliant shaft").verdict is StepVerdict.DIFFERS
    assert not [proposed for proposed in report.values if proposed.key == "passivity.moving_mass"]
    friction = "simulation.effects=[{type: coulomb_friction, kinetic: 0.2, static: 0.3}]"
    assert row(commissioned(friction), "compliant shaft").found.startswith("none found: 0.25")


def test_a_drive_that_goes_on_without_its_master_is_a_failure() -> None:
    report = commissioned("axes.0.watchdog=false", refused=MOVES)
    assert row(report, "watchdog").verdict is StepVerdict.FAILED
    assert "OPERATION ENABLED" in row(report, "watchdog").found


def test_an_axis_that_hangs_is_held_until_the_watchdog_sets_its_brake() -> None:
    brake = "axes.0.brake={release_time: 30 ms, set_time: 50 ms, holds_weight: 5 N}"

    def silent(at: str) -> None:
        session = Session(load_scene(DEMO, [at, brake]), Answers(), CommissioningLimits(), lambda: False)
        with session.rig_of(with_hand=False):
            pull_the_master(session)

    frames = frames_of(silent, "hung")
    silence = next(n for n, frame in enumerate(frames) if frame.arbitration_id == 0x081)
    assert torques(frames[:silence])[-1] == 500  # of 10 N; in vain where nothing hangs, as in this twin


def test_without_consent_no_frame_carries_a_torque() -> None:
    reports: list[Report] = []
    for refused in (r"now\?", "Enable"):
        frames = frames_of(
            lambda at, refused=refused: reports.append(commissioned(at, refused=refused)),  # type: ignore[misc]
            f"consent-{len(reports)}",
        )
        assert set(torques(frames)) <= {0}
    assert row(reports[0], "torque sign").verdict is StepVerdict.UNKNOWN
    assert len(torques(frames)) == 0  # not even enabled


@pytest.mark.slow
def test_no_torque_exceeds_a_lower_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mass_and_friction, "_DOUBLETS", (8,))
    limits = CommissioningLimits(torque=0.02)
    frames = frames_of(lambda at: commissioned(at, limits=limits), "announced")
    assert max(abs(torque) for torque in torques(frames)) in range(10, 21)  # 2 per cent of the rated torque


def test_the_first_torque_is_one_count_of_the_drives_target_and_each_pulse_at_most_doubles_it() -> None:
    _, frames = turned("torque")
    sizes = [abs(torque) for torque in torques(frames) if torque]
    assert sizes[0] == 1  # per mille of the rated torque
    assert all(after <= 2 * max(sizes[: place + 1]) for place, after in enumerate(sizes[1:]))


def test_an_axis_that_goes_too_far_loses_its_torque() -> None:
    report = commissioned(limits=CommissioningLimits(speed=1e-6))  # faster with the least torque
    assert row(report, "torque sign").verdict is StepVerdict.UNKNOWN
    assert "moved faster" in row(report, "torque sign").text
    assert not [finding for finding in report.findings if finding.item in ("torque scale", "moving mass")]


def test_the_operators_stop_ends_every_step() -> None:
    asked = iter(range(10**9))
    report = commissioned(stop=lambda: next(asked) > 500)
    assert "watchdog" not in [finding.item for finding in report.findings]


class Stranger:
    """A node on the far side that answers uploads of 0x1000, by literal bytes."""

    def __init__(self, bus: can.BusABC, node: int) -> None:
        self.bus, self.node = bus, node

    def process(self, now: int) -> None:
        while (message := self.bus.recv(0.0)) is not None:
            if message.arbitration_id == 0x600 + self.node and message.data == bytes.fromhex("4000100000000000"):
                data = bytes.fromhex("43 00 10 00 92 01 00 00")
                answer = can.Message(arbitration_id=0x580 + self.node, data=data, is_extended_id=False)
                self.bus.send(answer)

    def next_due(self) -> int:
        return 1 << 62


@pytest.mark.parametrize("node", [2, 5, 127])
def test_a_stranger_on_the_bus_is_found(node: int) -> None:
    with (
        can.Bus(interface="virtual", channel=f"stranger-{node}") as far,
        can.Bus(interface="virtual", channel=f"stranger-{node}") as near,
    ):
        link = Link(near, VirtualClock([Stranger(far, node)]))
        assert _scan(link, [1], 126) == [node]
        assert _scan(link, [1, node], 126) == []  # what is known is not asked


def test_a_drive_that_does_not_answer_ends_it_before_anything_is_enabled() -> None:
    channel = "silent"
    with pytest.raises(StartError, match=r"handle: presence: .* check power, node ID"):
        frames_of(lambda at: commissioned(at, "simulation.bus={drop: 1.0, bring_up: true}"), channel)


def test_axes_in_one_mechanism_are_refused() -> None:
    scene = load_scene(CONFIGS / "xy_box.yaml", [])
    session = Session(scene, Answers(), CommissioningLimits(), lambda: False)
    with pytest.raises(InputError, match="mechanism"):
        commission(session, TIMED)


@pytest.mark.slow
def test_bounds_of_damping_friction_and_jitter_are_proposed_on_the_safe_side() -> None:
    report = commissioned("simulation.effects=[{type: coulomb_friction, kinetic: 0.2, static: 0.3}]")
    lag = row(report, "torque lag")
    assert (lag.configured, lag.verdict) == ("none", StepVerdict.MEASURED)
    assert lag.found.startswith("not measurable (resolution")  # dry friction is not taken for a lag
    assert 0.3 < float(value(report, "passivity.device_friction_bound")) < 0.6
    assert float(value(report, "passivity.device_damping_bound")) > 0.1
    assert float(value(report, "passivity.sync_jitter")) >= 0.01


def test_a_number_of_the_drive_is_written_whole() -> None:
    values = [
        Value("handle", "product_code", 1_699_872_768, ""),
        Value("handle", "passivity.moving_mass", 0.000284654321, "kg*m^2"),
        Value("handle", "passivity.current_lag", 123.4e-6, "s"),
        Value("handle", "passivity.sync_jitter", 0.01, "1"),
        Value("handle", "counts_per_unit", None, "count/m"),
    ]
    assert [value.text for value in values] == ["1699872768", "0.000284654 kg*m^2", "123.4 us", "1 %", None]


@pytest.mark.parametrize(
    ("scene", "key", "path"),
    [
        ("demo.yaml", "passivity.moving_mass", ("passivity", "moving_mass")),
        ("demo.yaml", "counts_per_unit", ("axes", "0", "counts_per_unit")),
        ("xy_box.yaml", "passivity.moving_mass", ("axes", "0", "passivity", "moving_mass")),
        ("admittance/guided_path.yaml", "passivity.drive_mass", ("groups", "stage", "passivity", "drive_mass")),
    ],
)
def test_a_value_is_written_where_the_scene_has_it(scene: str, key: str, path: tuple[str, ...]) -> None:
    loaded, report = load_scene(CONFIGS / scene), Report()
    for axis, measured in zip(loaded.axes, (2.0, 1.0), strict=False):
        report.values.append(Value(axis.parameters.name, key, measured, "kg"))
    assert [change.value for change in report.changes(loaded) if change.path == path] == ["2 kg"]


def test_what_a_simulated_drive_gave_is_marked_for_a_real_one_and_verifies_no_torque() -> None:
    loaded, report = load_scene(DEMO), Report()
    report.values += [Value("handle", "torque_verified", "mass", ""), Value("handle", "counts_per_unit", 1e5, "1/m")]
    [change] = report.changes(loaded)
    assert change.path[-1] == "counts_per_unit"
    assert (change.comment or "").startswith(TO_SET)


def test_a_failure_that_no_value_mends_and_a_step_that_was_left_out_are_named() -> None:
    report = Report()
    for item, verdict in (("a", StepVerdict.AGREES), ("moving mass", StepVerdict.FAILED), ("b", StepVerdict.FAILED)):
        report.findings.append(StepFinding("x", item, "", "found", verdict))
    assert report.unfinished(["x"], ["a", "moving mass"]) == ["x: b: found"]
    assert report.unfinished(["x", "y"], ["a"]) == ["y: a: not verified", "x: b: found"]


def test_a_stop_before_the_first_cycle_ends_the_standstill_without_a_finding() -> None:
    session = Session(load_scene(DEMO), Answers(), CommissioningLimits(), lambda: True)
    with session.rig_of(with_hand=False):
        assert not stand_still(session, 0)
    assert row(session.report, STANDSTILL).found == "not tried"


@pytest.mark.slow
@pytest.mark.parametrize(("is_stopped", "found"), [(False, "stopped"), (True, "not tried")])
def test_a_pulse_that_was_cut_short_says_nothing_of_friction_and_asks_for_no_larger_torque(is_stopped, found) -> None:
    """A TPDO that is lost ends the pulse: what moved until then gave a mass, or asked for twice the torque."""
    reports: list[Report] = []

    def pulsed(at: str) -> None:
        scene = load_scene(DEMO, ["simulation.bus={drop: 0.5, ids: [0x181]}", "bus.loss_limit=0.9", at])
        session = Session(scene, Answers(), CommissioningLimits(), lambda: is_stopped)
        with session.rig_of(with_hand=False):
            assert pulse(session, 0) is None
        reports.append(session.report)

    frames = frames_of(pulsed, f"cut_short_{is_stopped}")
    assert row(reports[0], "torque sign").found == found
    assert max(map(abs, torques(frames)), default=0) <= 10  # 1 per cent of the rated torque

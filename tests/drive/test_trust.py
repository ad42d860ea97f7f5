"""Links and torques are trusted as far as they were seen: losses by a budget, torques by the commands that may act."""

import math
import random
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.cycle import run
from canhaptic.drive.safety.link_policy import LinkPolicy, LossBudget, StopReason
from canhaptic.drive.safety.torque_check import TorqueCheck
from canhaptic.errors import RigError
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.buses import kind_of
from canhaptic.scene.load import load_scene, scene_from_mapping
from canhaptic.scene.models import Scene
from tests.drawn import examples
from tests.drive.drive_bench import MakeBench, started
from tools.bench.demo import CONFIG, IN_CONTACT
from tools.truth.faults import TwinBus
from tools.truth.scenes import SOURCE, random_scene

STOP = 20
BEGIN = 0.25  # [s]
CONTACT = (*IN_CONTACT, "environment.side=above")


@settings(max_examples=examples(60))
@given(st.lists(st.integers(1, 30), min_size=1, max_size=60), st.floats(0.0, 1.0), st.floats(0.0, 20.0))
def test_a_budget_bounds_the_losses_of_every_stretch_of_a_run(gaps: list[int], limit: float, most: float) -> None:
    budget, at, lost = LossBudget(limit, most), 0, list[int]()
    for gap in gaps:
        at += gap
        lost.append(at)
        is_spent = budget.lose(at)
        stretches = (len(lost) - n - limit * (at - begin) for n, begin in enumerate(lost))
        assert budget.level == pytest.approx(max(stretches))
        assert is_spent == (budget.level > most)


@pytest.mark.parametrize(("rate", "most"), [(40.0, 10.0), (20_000.0, 20.0)])
def test_one_per_cent_of_the_frames_ends_no_run_in_a_million_hours(rate: float, most: float) -> None:
    share, limit = 0.03, 0.1
    low, high = 0.1, 10.0  # the root of a convex function that is 0 at 0 too
    for _ in range(60):
        theta = 0.5 * (low + high)
        is_below = 1.0 - share + share * math.exp(theta) < math.exp(limit * theta)
        low, high = (theta, high) if is_below else (low, theta)
    assert math.exp(-low * most) * share * rate * 3600.0 < 1e-6


def losses(share: float, rate: float, seconds: float, seed: int) -> int | None:
    """SYNCs after which a bus that loses so many samples by chance ends a run; None: it does not."""
    random_, policy = random.Random(seed), LinkPolicy(2, STOP, 0.1, rate)
    for sync in range(round(seconds * rate)):
        if random_.random() >= share:
            policy.on_tpdo()
            continue
        policy.on_missed()
        if policy.lose():
            return sync
    return None


@pytest.mark.parametrize("rate", [40.0, 200.0, 1000.0])
def test_half_of_the_samples_lost_ends_a_run_within_a_second_and_one_in_a_hundred_never(rate: float) -> None:
    stops = [losses(0.5, rate, 2.0, seed) for seed in range(40)]
    assert None not in stops
    assert sum(stop is not None and stop < rate for stop in stops) >= 38  # of 40 SYNCs, chance may lose fewer
    assert losses(0.01, rate, 20_000.0 / rate, 1) is None


@settings(max_examples=examples(60))
@given(
    st.lists(st.integers(-1000, 1000), min_size=8, max_size=40), st.integers(0, 2), st.floats(0.0, 1.0),
    st.integers(0, 1000),
)  # fmt: skip
def test_a_torque_that_is_late_limited_and_filtered_contradicts_no_command(commands, late, share, limit) -> None:
    check = TorqueCheck(3, 0.5)
    for now in range(2, len(commands)):
        check.commands.append(commands[now])
        acting = [max(-limit, min(limit, commands[now - n])) for n in (late, min(2, late + 1))]
        check.judge(round(share * acting[0] + (1.0 - share) * acting[1]), ())
        assert check.contradicted == 0 or now < 4  # two holds before the first were not recorded


@settings(max_examples=examples(60))
@given(st.lists(st.integers(-1000, 1000), min_size=3, max_size=30), st.integers(1, 4), st.integers(0, 100), st.data())
def test_a_torque_beyond_all_commands_that_may_act_is_counted_until_one_is_within(commands, holds, tolerance, data):
    check, counted = TorqueCheck(holds, tolerance), 0
    for now, command in enumerate(commands):
        check.commands.append(command)
        hull = [0, *commands[max(0, now + 1 - holds) : now + 1]]
        read = data.draw(st.integers(-2000, 2000))
        check.judge(read, ())
        is_within = min(hull) - tolerance <= read <= max(hull) + tolerance
        counted = 0 if is_within else counted + 1
        assert check.contradicted == counted
        assert is_within or check.last == (read, min(hull), max(hull))


class Ended:
    """The demo in contact with something wrong from `BEGIN` on: what ended it, and when."""

    def __init__(self, *overrides: str, seconds: float = 0.5) -> None:
        with build(load_scene(CONFIG, [*CONTACT, *overrides]), "free") as experiment:
            self.text = ""
            try:
                run(experiment.cycle, round(seconds * 1000))
            except RigError as error:
                self.text = str(error)
            self.reason = experiment.rig.stop_reason
            self.syncs = experiment.cycle.cycles - round(BEGIN * 1000)
            self.is_safe = is_without_torque(experiment)
            self.link = experiment.rig.link_statistics()


def is_without_torque(experiment: Experiment) -> bool:
    assert experiment.far_side is not None
    return all(drive.torque == 0.0 for drive in experiment.far_side.drives)


@pytest.mark.slow_but("kind:?minus-both", "kind:?more*-actual")
@pytest.mark.parametrize("shown", ["actual", "both"])
@pytest.mark.parametrize("fault", ["kind: twice", "kind: minus", "kind: more, torque: -10 N"])
def test_a_drive_that_applies_another_torque_than_commanded_ends_the_run(fault: str, shown: str) -> None:
    read_back = "actual" if shown == "actual" else "demand"
    found = Ended(
        f"simulation.drive.fault=[{{at: {BEGIN}, {fault}, shown: {shown}}}]", f"axes.0.read_back={read_back}",
        "axes.0.energy_loss_limit=none", "axes.0.energy_uncertainty_limit=none",
    )  # fmt: skip
    assert found.reason is StopReason.TORQUE_CONTRADICTED, found.text
    assert STOP <= found.syncs <= STOP + 3
    assert "20 SYNCs in a row, read" in found.text
    assert found.is_safe


def test_a_drive_that_holds_its_torque_for_good_ends_the_run_as_one_that_lost_its_commands() -> None:
    found = Ended(f"simulation.drive.fault=[{{at: {BEGIN}, kind: stuck, shown: both}}]")
    assert (found.reason, found.is_safe) == (StopReason.COMMAND_LOST, True), found.text
    assert found.syncs <= 2 * STOP


@pytest.mark.slow_but("drop:?0.5,?ids:*0x201*", "*every?19?of?20*")
@pytest.mark.parametrize(
    ("bus", "most"),
    [
        ("drop: 0.5, ids: [0x181]", 80),
        ("drop: 0.5, ids: [0x201]", 150),
        ("truncate: 0.6, ids: [0x181]", 80),
        ("drop: 0.4, drop_burst: 8, ids: [0x181]", 250),
        ("drop: 1.0, ids: [0x181], every 19 of 20", 45),
    ],
)
def test_a_link_that_loses_much_but_never_too_much_in_a_row_ends_the_run(bus: str, most: int) -> None:
    during = f"during: [{{begin: {BEGIN}, duration: 100 s}}]"
    if "every" in bus:
        bus = bus.partition(", every")[0]
        during = f"during: [{{begin: {BEGIN}, duration: 18.5 ms, every: 20 ms}}]"
    found = Ended(f"simulation.bus={{{bus}, {during}}}", "axes.0.energy_uncertainty_limit=none", seconds=1.0)
    assert (found.reason, found.is_safe) == (StopReason.FRAMES_LOST, True), found.text
    assert found.syncs <= most
    assert "of all SYNCs answered" in found.text


@pytest.mark.slow
def test_one_lost_frame_in_a_hundred_is_endured() -> None:
    found = Ended("simulation.bus={drop: 0.01}", seconds=1.0)
    assert found.reason is StopReason.OPERATOR
    assert 0.95 < found.link["success_rate"] < 1.0


def test_an_account_that_no_longer_knows_the_energy_ends_the_run() -> None:
    moving = (
        "simulation.user.motion.frequency=2",
        "environment.stiffness=800",
        "bus.loss_limit=1",
        "axes.0.energy_uncertainty_limit=0.1 W",
    )
    found = Ended(*moving, "simulation.bus={drop: 0.3, ids: [0x181]}", "axes.0.energy_loss_limit=none", seconds=1.5)
    assert (found.reason, found.is_safe) == (StopReason.ENERGY_UNCERTAIN, True), found.text
    assert "beyond energy_uncertainty_limit (0.1 J/s)" in found.text


LOSING = ("simulation.bus={drop: 0.1}", "bus.loss_limit=1")


def reason_of(scene: Scene, seconds: float) -> StopReason:
    """What ended a run of a scene; OPERATOR: its time was over."""
    with build(scene, "free") as experiment:
        with suppress(RigError):
            run(experiment.cycle, round(seconds / scene.bus.sample_time))
        return experiment.rig.stop_reason


@pytest.mark.slow_but("accuracy/stiff_stop")
@pytest.mark.parametrize("name", ["accuracy/stiff_stop", "accuracy/delayed_bus", "hard/sudden_pull"])
def test_by_default_a_bus_that_loses_a_tenth_ends_a_run_whose_account_it_leaves_useless(name: str) -> None:
    scene = load_scene(CONFIG.parent / f"{name}.yaml", LOSING)
    assert reason_of(scene, 0.8) is StopReason.ENERGY_UNCERTAIN


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["", "accuracy", "hard", "published"])
def test_by_default_no_shipped_scene_ends_for_one_lost_frame_in_a_hundred(folder: str) -> None:
    key, reasons = {"can": "drop", "ethercat": "lost"}, {}
    for path in sorted((CONFIG.parent / folder).glob("*.yaml")):
        scene = load_scene(path)
        if scene.simulated and scene.far is None:  # a side of a link runs with the other alone
            losing = f"simulation.bus={{{key[kind_of(scene.bus)]}: 0.01}}"
            reasons[path] = reason_of(load_scene(path, [losing]), 1.5)
    assert len(reasons) >= 5
    assert StopReason.ENERGY_UNCERTAIN not in reasons.values(), reasons


@pytest.mark.parametrize(("declared", "reason"), [(None, "OPERATOR"), ("0.1 W", "ENERGY_UNCERTAIN")])
def test_what_timing_alone_leaves_uncertain_counts_only_where_it_is_declared(declared: str | None, reason: str) -> None:
    """SYNCs of uneven length at 100 Hz: 0.26 W, with every declaration true and no frame lost."""
    values = random_scene(21).values
    values["axes"][0]["energy_uncertainty_limit"] = declared
    assert reason_of(scene_from_mapping(values, SOURCE), values["duration"]).name == reason


@pytest.mark.parametrize(("is_first", "moved"), [(True, 300), (False, 300), (True, -300)])
def test_a_second_sender_is_named_and_its_samples_are_lost(bench: MakeBench, is_first: bool, moved: int) -> None:
    b = started(bench)
    b.run(20, torque=1.0)
    link: Any = b.links[0]
    link._bus = twins = TwinBus(link._bus, 0x185, moved, is_first=is_first)
    with pytest.raises(RigError, match=r"TPDO 0x185 with different content for one SYNC.*TPDO_CONTRADICTED"):
        b.run(60, torque=1.0)
    assert twins.sent <= STOP + 10  # the stop hears some
    assert b.rig.drives[0].policy.missed_total >= STOP - 2
    assert b.drives[0].torque == 0.0


def test_a_host_that_skips_every_second_sync_is_stopped_within_seconds(bench: MakeBench) -> None:
    b = started(bench, bus={"heartbeat_timeout": 1.0})

    def halve() -> None:
        for _ in range(4000):
            b.rig.sync()
            b.clock.wait_until(b.clock.now() + 1_600_000)
            b.rig.write_torques([0.0])

    with pytest.raises(RigError, match=r"late for too many SYNCs.*beyond bus.loss_limit \(10 %\).*SYNCS_SKIPPED"):
        halve()
    assert b.rig.deadline_index < 3000

"""Run, `inspect`, page and scope give one account of a run, also where SYNCs were skipped or late and frames lost."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from canhaptic.audit.inspection import inspect
from canhaptic.cli.main import main
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.result import with_groups
from canhaptic.view.html_page import verdict_bar
from canhaptic.view.series import LiveLog

CONFIGS = Path(__file__).parents[2] / "configs"
WALL = ["environment.stiffness=2000", "environment.damping=4", "passivity.device_damping=0.05"]
LATE = "{ids: [0x80], direction: to_drive, delay: 0.4 ms, during: [{duration: 1.2 ms, every: 8 ms}]}"
UNTRUE = ["passivity.hand_force=0", "passivity.device_friction=1", "passivity.device_friction_bound=1"]
"""Friction that the plant does not have: a wall pushes the handle out faster."""
FALSE = [
    "environment.stiffness=4e4", "environment.damping=0", "passivity.hand_force=10", "passivity.moving_mass=0.75",
    "simulation.user.motion.phase=2.5", "simulation.user.motion.frequency=1",
]  # fmt: skip
RUNS = {
    "ideal": ("demo.yaml", WALL),
    "skipped SYNCs": ("demo.yaml", [*WALL, "simulation.bus={stall: [{begin: 0.3, duration: 5 ms, every: 0.21}]}"]),
    "uneven holds": ("demo.yaml", [*WALL, "simulation.bus={stall: [{begin: 0.3, duration: 0.3 ms, every: 0.21}]}"]),
    "late SYNCs": ("demo.yaml", [*WALL, *UNTRUE, f"simulation.bus={LATE}"]),
    "losses": ("demo.yaml", [*WALL, "simulation.bus={drop: 0.02}"]),
    "the paper's": ("paper_fig7_40hz.yaml", []),
    "a false mass": ("demo.yaml", FALSE),
    "group with losses": ("two_handles.yaml", ["groups.0.passivity.device_damping=0.05"]),
}  # fmt: skip
OF_A_PORT = (
    "passive", "passive_at_handle", "certificate", "certificates", "least_interaction", "least_at_handle",
    "energy_resolution", "contact", "rendered", "longest_hold", "open_hold", "in", "out",
    "branches", "damping_rendered", "friction_excess", "resolution_is_estimated", "active_since", "contradicted",
)  # fmt: skip
NOT_ALWAYS = (
    "rendered", "passive_at_handle", "least_at_handle", "friction_excess", "resolution_is_estimated", "active_since",
    "contradicted",
)  # fmt: skip


def same(left: Any, right: Any) -> bool:
    """Whether two values are equal but for the order of sums."""
    if isinstance(left, dict) and isinstance(right, dict):
        return left.keys() == right.keys() and all(same(left[key], right[key]) for key in left)
    if isinstance(left, float) and isinstance(right, float):
        return math.isclose(left, right, rel_tol=1e-9, abs_tol=1e-15)
    return left == right


@pytest.fixture(params=RUNS)
def run_and_log(request: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[dict[str, Any], Path]:
    name, changes = RUNS[request.param]
    path = tmp_path / "run.h5"
    words = [word for value in changes for word in ("--set", value)]
    main(["run", str(CONFIGS / name), "--pace", "free", "--duration", "0.8", "--log", str(path), "--json", *words])
    return json.loads(capsys.readouterr().out), path


@pytest.mark.slow
def test_every_view_gives_the_account_of_the_run(run_and_log: tuple[dict[str, Any], Path]) -> None:
    ran, path = run_and_log
    with EnergyLog.open(path) as log:
        inspected = inspect(log)
    news = LiveLog(path).look()
    live = with_groups(news.accounts, {})
    assert inspected["link"]["skipped_syncs"] == ran["link"]["skipped_syncs"]
    assert inspected["passive"] == ran["passive"]
    assert inspected.get("passive_at_handle") == ran.get("passive_at_handle")
    for name, port in ran["ports"].items():
        assert "group" in port or set(OF_A_PORT) - {*NOT_ALWAYS} <= set(port)
        for key in OF_A_PORT:
            if key in port and key in inspected["ports"][name]:
                assert same(inspected["ports"][name][key], port[key]), (name, key)
            if "group" not in port and key in live[name]:
                assert same(live[name][key], port[key]), (name, key)
        assert inspected["truth"][name] == pytest.approx(ran["truth"][name], rel=1e-6, abs=1e-12)
    alone = {name: port for name, port in inspected["ports"].items() if "group" not in port}
    by_frames: Any = {name: {k: v for k, v in of.items() if "plant" not in k} for name, of in alone.items()}
    verdicts = verdict_bar(with_groups(by_frames, {}))  # the log that grows is read without the plant
    assert verdicts == verdict_bar({name: live[name] for name in live if "group" not in ran["ports"][name]})


@pytest.mark.slow
def test_a_wall_that_the_torque_limit_cuts_is_rendered_up_to_the_limit(tmp_path, capsys) -> None:
    path, most = tmp_path / "run.h5", 1.5
    wall = ["environment.stiffness=200 N/m", "environment.damping=0", "passivity={algorithm: unprotected}"]
    words = [word for value in (*wall, f"axes.0.torque_limit={most}") for word in ("--set", value)]
    main(["run", str(CONFIGS / "demo.yaml"), "--duration", "1.4", "--log", str(path), "--json", *words])
    ran = json.loads(capsys.readouterr().out)["ports"]["handle"]
    with EnergyLog.open(path) as log:
        inspected, port = inspect(log)["ports"]["handle"], log.ports["handle"]
        assert abs(port["torque_applied"]).max() <= most * (1.0 + 1e-9) < abs(port["torque_command"]).max()
        asked = port["effort_asked"] != 0.0
        sent = port["torque_command"][asked].clip(-most, most)
        share = -sent.sum() / port["effort_asked"][asked].sum()
    assert 0.1 < share < 0.9
    assert ran["contact"]["beyond_limit"] > 10
    for account in (ran, inspected):
        assert account["rendered"]["stiffness"] == pytest.approx(share, rel=1e-9)
        assert account["contact"]["sent"] == pytest.approx(abs(sent).sum(), rel=1e-9)

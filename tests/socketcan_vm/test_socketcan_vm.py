"""The package over Linux's own SocketCAN, without hardware: vcan, and two emulated SJA1000 controllers on one bus.

One boot runs every scenario of `guest/scenarios.py`; the tests judge what it measured, by the guest's own clock.
"""

import subprocess
from typing import Any

import pytest

from tests.socketcan_vm.image import PROJECT, build_image, missing_tools
from tests.socketcan_vm.machine import boot

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

BOOT_TIMEOUT = 1500.0  # [s] a minute on an idle machine
CYCLES = 1080
MOST_BUSY = 0.5  # share of the guest's processor
STOP_CYCLES = 20  # bus.stop_cycles of the scene: missed SYNCs after which the torque is zero
SCENARIOS = {"vcan", "example", "kvaser", "link_down", "killed"}
Results = dict[str, dict[str, Any]]


@pytest.fixture(scope="module")
def guest() -> Results:
    """What every scenario measured; skips where the machine cannot be had."""
    missing = missing_tools()
    if missing:
        pytest.skip(f"not on this host: {', '.join(missing)} (the packages are named in tests/socketcan_vm/README.md)")
    folder = PROJECT / "build/socketcan_vm"
    folder.mkdir(parents=True, exist_ok=True)
    try:
        image = build_image(folder)
    except subprocess.CalledProcessError as error:
        if error.cmd[0] != "apt-get" and error.cmd[0] != "apt-cache":
            raise
        pytest.skip(f"the kernel's package cannot be had: {error.stderr.strip()[-200:]}")
    results, output = boot(image, BOOT_TIMEOUT)
    assert set(results) == SCENARIOS, output[-3000:]
    return results


@pytest.mark.parametrize("bus", ["vcan", "kvaser"])
def test_a_whole_run_of_two_processes_loses_no_frame_and_skips_no_sync(guest: Results, bus: str) -> None:
    run = guest[bus]
    assert run.get("failed") is None
    assert run["ends"] == [0, 143], run["error"]  # completed; the drive ended by SIGTERM
    account, link = run["account"], run["account"]["link"]
    assert account["cycles"] == CYCLES
    lost = link["skipped_syncs"], link["missed_tpdos"], link["late"], link["error_frames"]
    print(f"{bus}: busy {run['busy']:.2f}, processes {run['processes']}")
    assert lost == (0, 0, 0, 0), (
        f"{bus}: SYNCs skipped, TPDOs missed and late, error frames {lost}; processes {run['processes']}; late SYNCs "
        f"[number, seconds to the next, ms by process around it]: {run['late']}"
    )
    assert run["busy"] <= MOST_BUSY
    assert run["syncs"] == run["tpdos"] >= CYCLES
    assert run["most_torque"] > 500  # it was a contact
    assert run["last_torque"] == [0]
    port = account["ports"]["handle"]
    assert port["least_interaction"] >= -1e-9
    assert port["margin"]["value"] >= -1e-9


def test_the_marked_example_runs_on_vcan_within_its_torque_limit(guest: Results) -> None:
    run = guest["example"]
    assert run.get("failed") is None
    assert run["ends"] == [0, 143], run["error"]
    assert run["account"]["status"] == "completed"
    assert 0 < run["most_torque"] <= 50  # 5 % of the rated torque


@pytest.mark.parametrize("bus", ["vcan", "kvaser"])
def test_no_two_syncs_are_a_burst(guest: Results, bus: str) -> None:
    assert guest[bus]["shortest_gap"] > 0.5e-3


@pytest.mark.parametrize("how", ["link_down", "killed"])
def test_a_drive_that_is_cut_off_gets_zero_torque_within_the_policy(guest: Results, how: str) -> None:
    run = guest[how]
    assert run.get("failed") is None
    assert run["ends"] == [3]
    assert run["held"] > 50  # there was a torque to take away
    assert run["syncs_to_zero"] <= STOP_CYCLES
    assert run["torque_after_zero"] is False
    assert "[TPDO_LOST]" in run["error"] or "[HEARTBEAT_LOST]" in run["error"]
    assert "torque is zero" in run["error"]

"""The preflight of an EtherCAT line: its interface is for the drives alone, and holds no frame back."""

import struct
from pathlib import Path

import pytest

from canhaptic.errors import LinkError
from canhaptic.host import capabilities, ethernet_state
from canhaptic.host.findings import PreflightFinding
from canhaptic.host.socketcan_state import require_preflight
from canhaptic.scene.load import load_scene
from tests.scene.scene_text import REPOSITORY

SCENE = REPOSITORY / "configs" / "ethercat.yaml"
HEAD = "Iface\tDestination\tGateway\tFlags\tRefCnt\tUse\tMetric\tMask\tMTU\tWindow\tIRTT\n"


@pytest.fixture
def computer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A computer with the interface eth1, up and for the drives alone."""
    (tmp_path / "net" / "eth1").mkdir(parents=True)
    (tmp_path / "net" / "eth1" / "flags").write_text("0x1003\n")
    (tmp_path / "route").write_text(HEAD + "eth0\t00000000\t010A0A0A\t0003\t0\t0\t0\t00000000\t0\t0\t0\n")
    monkeypatch.setattr(capabilities, "INTERFACES", tmp_path / "net")
    monkeypatch.setattr(ethernet_state, "_ROUTES", tmp_path / "route")
    monkeypatch.setattr(capabilities, "permitted", lambda: frozenset({"CAP_NET_RAW", "CAP_NET_ADMIN"}))
    return tmp_path


def driver(gro: int = 0, rx_usecs: int = 0) -> ethernet_state.Asker:
    def ask(interface: str, command: int, size: int) -> bytes | None:
        assert interface == "eth1"
        if command == 0x0E:
            return struct.pack("=23I", command, rx_usecs, *[0] * 21)
        return struct.pack("=II", command, gro if command == 0x2B else 0)

    return ask


def judged(ask: ethernet_state.Asker | None = None) -> dict[str, PreflightFinding]:
    return {found.item: found for found in ethernet_state.inspect_interface("eth1", ask or driver())}


def test_an_interface_for_the_drives_alone_is_well(computer: Path) -> None:
    found = judged()
    assert {of.severity for of in found.values()} == {"well"}
    assert set(found) == {"link", "default route", "bridge", "capabilities", "offloads", "coalescing"}


def test_the_interface_of_the_network_is_refused(computer: Path) -> None:
    path = computer / "route"
    path.write_text(path.read_text().replace("eth0", "eth1"))
    assert judged()["default route"].severity == "refused"
    with pytest.raises(LinkError, match="eth1: default route: got here, expected an interface for the drives alone"):
        require_preflight(load_scene(SCENE, ["bus.interface=eth1"]).loaded_buses)


def test_a_link_that_is_down_in_a_bridge_or_not_permitted_is_refused(computer: Path, monkeypatch) -> None:
    (computer / "net" / "eth1" / "flags").write_text("0x1002\n")
    (computer / "net" / "br0").mkdir()
    (computer / "net" / "eth1" / "master").symlink_to("../br0")
    monkeypatch.setattr(capabilities, "permitted", lambda: frozenset({"CAP_NET_RAW"}))
    found = judged()
    assert (found["link"].seen, found["bridge"].seen, found["capabilities"].seen) == (
        "down", "br0", "without CAP_NET_ADMIN",
    )  # fmt: skip
    assert {found[item].severity for item in ("link", "bridge", "capabilities")} == {"refused"}
    assert "setcap" in found["capabilities"].text


def test_offloads_and_coalescing_are_notes_with_the_commands_that_end_them(computer: Path) -> None:
    found = judged(driver(gro=1, rx_usecs=125))
    assert "ethtool -K eth1 gro off" in found["offloads"].text
    assert "ethtool -C eth1 rx-usecs 0" in found["coalescing"].text
    assert {found[item].severity for item in ("offloads", "coalescing")} == {"note"}
    assert judged(lambda *_: None)["coalescing"].seen == "not reported"


def test_no_interface_of_the_name_is_refused(computer: Path) -> None:
    [found] = ethernet_state.inspect_interface("eth7", driver())
    assert (found.severity, found.seen) == ("refused", "none")

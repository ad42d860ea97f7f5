"""What a line on a wire needs of this computer, each named with its remedy where it is missing; no root needed."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from canhaptic.cli.main import main
from canhaptic.drive.ethercat.with_pysoem import load_pysoem
from canhaptic.errors import InputError
from canhaptic.host import capabilities
from canhaptic.host.socketcan_state import all_links_are_virtual
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from tests.scene.scene_text import REPOSITORY

SCENE = REPOSITORY / "configs" / "ethercat.yaml"


def test_without_pysoem_a_wire_is_refused_with_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pysoem", None)
    with pytest.raises(InputError, match=r"needs pysoem, which is not installed; pip install .*\[ethercat\]"):
        build(load_scene(SCENE, ["bus.interface=eth9"]))


def test_another_version_of_pysoem_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    other = type(sys)("pysoem")
    other.__version__ = "2.0"  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "pysoem", other)
    with pytest.raises(InputError, match=r"got version 2\.0, expected 1\.1\.13"):
        load_pysoem()


def test_an_interface_is_named_with_what_it_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "got no such interface, expected one of" in capabilities.opening_objection("nothing0")
    monkeypatch.setattr(capabilities, "permitted", lambda: frozenset({"CAP_NET_RAW"}))
    text = capabilities.opening_objection("lo")
    assert "without CAP_NET_ADMIN; as root, or once: sudo setcap cap_net_raw,cap_net_admin+ep /" in text
    monkeypatch.setattr(capabilities, "permitted", lambda: frozenset({"CAP_NET_RAW", "CAP_NET_ADMIN"}))
    monkeypatch.setattr(capabilities, "is_up", lambda _: False)
    assert "is down; sudo ip link set lo up" in capabilities.opening_objection("lo")


@pytest.mark.parametrize(
    ("link", "is_virtual"),
    [
        ({"linkinfo": {"info_kind": "veth"}}, True),
        ({"linkinfo": {"info_kind": "veth"}, "master": "br0"}, False),
        ({"linkinfo": {"info_kind": "bridge"}}, False),
        ({}, False),
    ],
)
def test_only_a_veth_that_no_bridge_owns_has_no_real_drive(link: dict[str, object], is_virtual: bool) -> None:
    scene = load_scene(SCENE, ["bus.interface=vt0"])

    def ip(command: list[str]) -> "subprocess.CompletedProcess[str]":
        assert command[-1] == "vt0"
        return subprocess.CompletedProcess(command, 0, json.dumps([link]), "")

    assert all_links_are_virtual(scene.loaded_buses, ip) is is_virtual


def test_drives_behind_no_interface_are_refused_with_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive", str(SCENE)]) == 2
    assert "veth pair" in capsys.readouterr().err


def test_a_hardware_scene_may_leave_places_of_the_line_out(tmp_path: Path) -> None:
    text = SCENE.read_text(encoding="utf-8").partition("# Present only")[0].replace("virtual ", "eth9 ")
    file = tmp_path / "scene.yaml"
    file.write_text(text.replace("ethercat_servo.xml", str(REPOSITORY / "eds" / "ethercat_servo.xml")))
    assert load_scene(file, ["axes.0.position=3"]).axes[0].parameters.position == 3  # type: ignore[attr-defined]

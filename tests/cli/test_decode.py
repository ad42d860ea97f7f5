import json
from pathlib import Path

import pytest

from canhaptic.logs.decoder import BusDecoder
from canhaptic.scene.load import load_scene
from canhaptic.scene.scene_logs import describe_nodes
from tests.view import typed

ROOT = Path(__file__).parents[2]

BUS_LOG = """\
(0000000000.000000) vcan0 601#23001A0110004160 T
(0000000000.000000) vcan0 581#60001A0100000000 R
(0000000000.000000) vcan0 601#2F001A0001000000 T
(0000000000.000000) vcan0 581#60001A0000000000 R
(0000000001.000000) vcan0 080# T
(0000000001.000000) vcan0 181#3712 R
(0000000002.000000) vcan0 081#0010010000000000 R
"""


@pytest.fixture
def bus_log(tmp_path: Path) -> Path:
    path = tmp_path / "bus.log"
    path.write_text(BUS_LOG)
    return path


def test_every_frame_becomes_a_line_and_maps_told_before_the_span_are_known(bus_log: Path, capsys) -> None:
    assert typed.decode(bus_log, "--from", "1", "--to", "2") == 0
    assert capsys.readouterr().out.splitlines() == [
        "      1.000000 vcan0 T 080                  SYNC",
        "      1.000000 vcan0 R 181 3712             TPDO1     node 1     statusword 0x1237 OPERATION ENABLED",
    ]


def test_one_kind_of_frame_can_be_asked_for_as_json(bus_log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert typed.decode(bus_log, "--only", "SYNC", "--only", "emcy") == 0
    assert [line.split()[4] for line in capsys.readouterr().out.splitlines()] == ["SYNC", "0010010000000000"]
    assert typed.decode(bus_log, "--only", "emcy", "--json") == 0
    (found,) = capsys.readouterr().out.splitlines()
    assert json.loads(found) == {
        "time": 2.0,
        "channel": "vcan0",
        "direction": "R",
        "id": 0x81,
        "data": "0010010000000000",
        "kind": "EMCY",
        "node": "node 1",
        "text": "0x1000 generic error, error register 0x01, vendor 00 00 00 00 00",
    }


def test_a_scene_gives_the_nodes_their_names() -> None:
    (node,) = describe_nodes(load_scene(ROOT / "configs" / "demo.yaml"))
    assert node.name
    assert node.counts_per_unit
    assert node.dictionary is not None


def test_torques_and_positions_are_those_of_the_axis_however_the_drive_counts() -> None:
    overrides = ["axes.0.direction=-1", "axes.0.quirks=[torque_per_cent]", "axes.0.rated_torque=10 N"]
    decoder = BusDecoder(describe_nodes(load_scene(ROOT / "configs" / "demo.yaml", overrides)))
    answers = {
        "4B74600032000000": "= 0x0032 (-5 N)",  # demand of 50 %
        "4B72600064000000": "= 0x0064 (10 N)",  # a limit has no direction
        "43646000E8030000": "= 0x000003E8 (-0.001 m)",
        "43646000FFFFFFFF": "= 0xFFFFFFFF (1e-06 m)",  # minus one count
    }
    for data, expected in answers.items():
        assert decoder.decode(0x581, bytes.fromhex(data)).text.endswith(expected)

import json
from pathlib import Path

import pytest

from canhaptic.scene.load import load_scene
from canhaptic.scene.node_names import describe_nodes
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


def test_every_frame_becomes_a_line_and_maps_told_before_the_span_are_known(
    bus_log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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

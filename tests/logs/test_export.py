import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from canhaptic.errors import InputError
from canhaptic.logs import export as module
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.export import export
from canhaptic.logs.writer_process import EnergyLogWriter
from tests.logs.log_rows import PORTS, SAMPLE_TIME_NS, append, balance, sample, timing
from tests.view import typed

ROWS = 700


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("export") / "run.h5"
    writer = EnergyLogWriter(
        path, PORTS, {"bus.rate": 1e3}, sample_time_ns=SAMPLE_TIME_NS, with_truth=True, pace="free"
    )
    for k in range(ROWS):
        append(writer, k, ports=2)
    writer.close()
    return path


@pytest.mark.slow
def test_a_parquet_table_holds_every_quantity_bit_for_bit_with_its_unit(path: Path, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(module, "_BLOCK", 300)
    parquet = pytest.importorskip(
        "pyarrow.parquet", reason="pyarrow is not installed (pip install 'canhaptic[export]')"
    )
    with EnergyLog.open(path) as log:
        export(log, tmp_path / "run.parquet")
        table = parquet.read_table(tmp_path / "run.parquet")
        assert table.num_rows == ROWS
        assert table.column("knob.interaction").to_numpy().tobytes() == log.ports["knob"]["h_i"].tobytes()
        assert table.column("true.handle.motor").to_pylist() == log.truth["handle"]["motor"].tolist()
        assert table.schema.field("handle.torque_applied").metadata == {b"unit": b"N"}
        assert table.schema.field("knob.torque_applied").metadata == {b"unit": b"N*m"}
        assert str(table.schema.field("handle.statusword").type) == "uint16"


@pytest.mark.slow
def test_a_mat_file_holds_ports_timing_and_attributes(path: Path, tmp_path: Path) -> None:
    scipy_io = pytest.importorskip("scipy.io", reason="SciPy is not installed (pip install 'canhaptic[export]')")
    with EnergyLog.open(path) as log:
        export(log, tmp_path / "run.mat")
    content = scipy_io.loadmat(tmp_path / "run.mat", simplify_cells=True)
    assert content["sample_time"] == 1e-3
    assert content["ports"]["knob"]["dissipated"][-1] == balance(ROWS - 1, 1).h_r
    assert content["attributes"]["bus_rate"] == 1e3
    assert math.isclose(content["truth"]["handle"]["position"][5], 0.0051)


@pytest.mark.slow
def test_an_mcap_file_holds_every_row_as_a_message_with_its_schema(path: Path, tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader", reason="mcap is not installed (pip install 'canhaptic[export]')")
    with EnergyLog.open(path) as log:
        export(log, tmp_path / "run.mcap")
        energies, units = log.ports["knob"]["h_i"].tolist(), log.ports["knob"].unit("h_i")
    layout = json.loads((tmp_path / "run.foxglove.json").read_text())
    drawn = [line["value"] for panel in layout["configById"].values() for line in panel.get("paths", ())]
    assert {"/handle.position", "/handle.torque_applied", "/handle.interaction"} <= set(drawn)
    assert set(re.findall(r"\w+![a-z0-9]+", json.dumps(layout["layout"]))) == set(layout["configById"])
    with (tmp_path / "run.mcap").open("rb") as file:
        summary = reader.make_reader(file).get_summary()
        topics = {channel.topic for channel in summary.channels.values()}
        file.seek(0)
        messages = list(reader.make_reader(file).iter_messages(topics=["/knob"]))
    assert topics == {"/timing", "/handle", "/knob", "/true/handle", "/true/knob", "/events"}
    assert [json.loads(message.data)["interaction"] for _, _, message in messages] == energies
    assert [message.log_time for _, _, message in messages] == [k * SAMPLE_TIME_NS for k in range(ROWS)]
    schema, channel, _ = messages[0]
    assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
    assert json.loads(schema.data)["properties"]["interaction"] == {
        "type": "number",
        "description": f"net energy (in - out) [{units}]",
    }


@pytest.mark.slow
def test_an_event_behind_skipped_syncs_has_the_time_of_its_row(tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader", reason="mcap is not installed (pip install 'canhaptic[export]')")
    writer = EnergyLogWriter(tmp_path / "run.h5", PORTS[:1], {}, sample_time_ns=SAMPLE_TIME_NS, pace="free")
    for k in range(10):
        writer.append(k, [sample(k)], [balance(k)], timing(k), deadline=k if k < 5 else k + 300)
    writer.event(8, "stop", "", "by the operator")
    writer.close()
    with EnergyLog.open(tmp_path / "run.h5") as log:
        export(log, tmp_path / "run.mcap")
    with (tmp_path / "run.mcap").open("rb") as file:
        [(_, _, message)] = reader.make_reader(file).iter_messages(topics=["/events"])
    assert message.log_time == 308 * SAMPLE_TIME_NS


@pytest.mark.slow
def test_floats_in_csv_read_back_to_the_same_bits(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_BLOCK", 300)
    with EnergyLog.open(path) as log:
        export(log, tmp_path / "run.csv")
        header = (tmp_path / "run.csv").read_text().partition("\n")[0].split(",")
        values = np.genfromtxt(tmp_path / "run.csv", delimiter=",", skip_header=1)
        assert header[0] == "time [s]"
        assert values[:, 0].tolist() == (log.deadlines(0, log.rows) * log.sample_time).tolist()
        column = values[:, header.index("handle.h_m [J]")]
        assert column.tobytes() == log.ports["handle"]["h_m"].tobytes()


@pytest.mark.slow_but("csv")
@pytest.mark.parametrize("suffix", ["csv", "parquet", "mat", "mcap"])
def test_a_table_that_cannot_be_written_is_one_clear_error(path: Path, tmp_path: Path, suffix: str) -> None:
    target = tmp_path / "no" / f"run.{suffix}"
    with EnergyLog.open(path) as log, pytest.raises(InputError, match=rf"no/run\.{suffix}: "):
        export(log, target)


def test_another_suffix_is_refused_with_those_that_exist(path: Path, tmp_path: Path) -> None:
    with EnergyLog.open(path) as log, pytest.raises(InputError, match=r"\.csv, \.parquet, \.mat"):
        export(log, tmp_path / "run.xlsx")


@pytest.mark.slow
def test_an_installed_package_exports_in_its_own_format(path: Path, tmp_path, monkeypatch) -> None:
    about = tmp_path / "site" / "my_tables-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: my-tables\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[canhaptic.exporters]\nxyz = my_tables_for_tests:write\nbad = absent:write\n"
    )
    module_text = "def write(log, path):\n    path.write_text(f'{log.rows} rows of {list(log.ports)}')\n"
    (about.parent / "my_tables_for_tests.py").write_text(module_text)
    monkeypatch.syspath_prepend(str(about.parent))
    assert typed.inspect(path, "--export", tmp_path / "run.xyz") == 0
    with EnergyLog.open(path) as log:
        assert (tmp_path / "run.xyz").read_text() == f"{log.rows} rows of {list(log.ports)}"
        with pytest.raises(InputError, match=r"bad: the plug-in my-tables 1\.0 cannot be used \(.*absent"):
            export(log, tmp_path / "run.bad")
        with pytest.raises(InputError, match=r"expected one of: \.csv, .*\.xyz, \.bad"):
            export(log, tmp_path / "run.abc")

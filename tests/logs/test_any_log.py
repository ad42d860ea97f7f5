"""Any content of a file that should be a log: frames, an account, or one LogFormatError; never anything else."""

from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from canhaptic.audit.recompute import rederive
from canhaptic.cycle import run
from canhaptic.errors import InputError, LogFormatError
from canhaptic.logs.bus_reader import read_bus_log
from canhaptic.logs.decoder import BusDecoder
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.writer_process import BusLogWriter
from canhaptic.replay import replay_bus_log
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from tests.drawn import examples

DEMO = Path(__file__).parents[2] / "configs" / "demo.yaml"
QUICK = settings(
    max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)

CAN_IDS = st.sampled_from([0x000, 0x080, 0x081, 0x181, 0x201, 0x581, 0x601, 0x701, 0x77E, 0x7FF]) | st.integers(
    0, 0x7FF
)
FRAMES = st.lists(st.tuples(st.integers(0, 5_000_000), CAN_IDS, st.binary(max_size=8), st.booleans()), max_size=40)
LINES = st.lists(
    st.text(max_size=60)
    | st.builds(
        lambda time, channel, name, data, end: f"({time}) {channel} {name}#{data}{end}",
        st.from_regex(r"[0-9]{1,30}\.[0-9]{1,9}", fullmatch=True),
        st.sampled_from(["can0", "0", "é"]),
        st.from_regex(r"[0-9A-F]{1,9}", fullmatch=True),
        st.from_regex(r"[0-9A-Fa-f]{0,140}", fullmatch=True),
        st.sampled_from(["", " R", " T", " X", "\r"]),
    )
    | st.from_regex(
        r"(\([0-9]{3}\.[0-9]{6}\)|\([0-9:. -]{10,30}\)|) ?can[0-9]  [0-9A-F]{3} {1,3}[\[{][0-9][\]}][ 0-9A-Z'.]{0,30}"
    )
    | st.from_regex(r"[0-9.]{1,22},[0-9A-F]{1,9},(true|false),(Rx,|)[0-9]{1,3},[0-9]{1,3}[,0-9A-F]{0,30}"),
    max_size=8,
)


@QUICK
@given(LINES)
def test_any_text_is_frames_or_one_error(tmp_path: Path, lines: list[str]) -> None:
    path = tmp_path / "a.log"
    path.write_bytes("\n".join(lines).encode())
    decoder = BusDecoder()
    try:
        for frame in read_bus_log(path):
            decoder.decode(frame.can_id, frame.data)
    except LogFormatError as error:
        told = str(error)
    else:
        told = str(path)
    assert str(path) in told


@pytest.fixture(scope="module")
def whole_logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Returns a small log in every binary and text format."""
    folder = tmp_path_factory.mktemp("logs")
    contents = {}
    for suffix in ("log", "blf", "trc", "asc"):
        log = BusLogWriter(folder / f"a.{suffix}", "can0", pace="free")
        for k in range(20):
            log(k * 1_000_000, 0x181 + k % 3, bytes([k] * (k % 9)), k % 2 == 0)
        log.close()
        contents[suffix] = (folder / f"a.{suffix}").read_bytes()
    return contents


def damaged(content: bytes, places: list[tuple[int, int]], kept: int) -> bytes:
    """Returns bytes with some of them replaced and the end cut off."""
    changed = bytearray(content)
    for place, value in places:
        changed[place % len(changed)] = value
    return bytes(changed[: max(1, kept % (len(changed) + 1))])


DAMAGE = st.tuples(
    st.lists(st.tuples(st.integers(0, 1 << 20), st.integers(0, 255)), max_size=6), st.integers(1, 1 << 20)
)


@pytest.mark.slow_but("log")
@pytest.mark.parametrize("suffix", ["log", "blf", "trc", "asc"])
@QUICK
@given(DAMAGE | st.binary(min_size=1, max_size=300))
def test_any_damage_to_a_bus_log_is_frames_or_one_error(whole_logs, tmp_path, suffix, damage):
    path = tmp_path / f"b.{suffix}"
    path.write_bytes(damage if isinstance(damage, bytes) else damaged(whole_logs[suffix], *damage))
    try:
        for frame in read_bus_log(path):
            assert 0 <= frame.can_id < 1 << 32
    except LogFormatError as error:
        told = str(error)
    else:
        told = str(path)
    assert str(path) in told


@QUICK
@given(FRAMES)
def test_any_frames_are_replayed_and_rederived_or_refused(tmp_path, frames: list[tuple[int, int, bytes, bool]]) -> None:
    path, time, lines = tmp_path / "c.log", 0, []
    for after, can_id, data, is_rx in frames:
        time += after
        lines.append(
            f"({time // 1_000_000}.{time % 1_000_000:06d}) can0 {can_id:03X}#{data.hex()} {'R' if is_rx else 'T'}\n"
        )
    path.write_text("".join(lines))
    scene = load_scene(DEMO)
    for use in (
        lambda: rederive(path, scene),
        lambda: replay_bus_log(path, scene),
        lambda: replay_bus_log(path, scene, from_sync=True),
    ):
        with suppress(InputError):
            use()


# --- energy logs --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def energy_log(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("energy") / "a.h5"
    with build(load_scene(DEMO), energy_log=path) as experiment:
        run(experiment.cycle, 30)
    return path.read_bytes()


def read_all(path: Path) -> None:
    """Reads everything that a view reads."""
    with EnergyLog.open(path) as log:
        assert isinstance(log.status, str)
        assert log.sample_time_ns >= 0
        for port in log.ports.values():
            for name in port:
                port[name]
        list(log.events)


@QUICK
@given(
    st.lists(st.tuples(st.integers(0, 1 << 20), st.binary(min_size=1, max_size=8)), max_size=8), st.integers(1, 1 << 20)
)
def test_any_damage_to_an_energy_log_is_an_account_or_one_error(energy_log, tmp_path, places, kept):
    content = bytearray(energy_log)
    for place, data in places:
        place %= len(content) - 8
        content[place : place + len(data)] = data
    path = tmp_path / "b.h5"
    path.write_bytes(content[: max(1, kept if kept < len(content) else len(content))])
    with suppress(LogFormatError):
        read_all(path)

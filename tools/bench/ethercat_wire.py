"""Does a scene on EtherCAT run on a wire, by a foreign master, as it does in virtual time?

pysoem drives the simulated drives over a veth pair: needs root, pysoem, tshark and kickcat; captures and ESIs of
vendors where CANHAPTIC_CAPTURES names their folder. The rows join those of the question `ethercat`.
Times are compared side by side in one run: they are those of a shared computer. `--quick` does a tenth of the cycles,
and `--only` some kinds of rows; the others stay as they were recorded.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median
from time import perf_counter_ns
from typing import Any, Final, cast

import yaml

from canhaptic.canopen.esi import esi_devices
from canhaptic.canopen.sii import is_sii, read_sii
from canhaptic.cycle import Cycle
from canhaptic.drive.ethercat.esi_survey import choose, judge
from canhaptic.drive.ethercat.segment import FrameKind, al_text
from canhaptic.errors import DictionaryError, RigError
from canhaptic.logs.ethercat_frames import command_name, datagram_text, datagrams_of, read_capture
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import load_scene
from tests.wire.far_end import Watch
from tests.wire.veth import REALTIME, SCENE, FarEnd, command, sets, veth, wait
from tools.bench.demo import demo_values
from tools.bench.report import Row, out_folder, publish
from tools.make_esi import make_two_revisions
from tools.on_ethercat import on_ethercat

_ROOT: Final = Path(__file__).resolve().parents[2]
_RECORDED: Final = _ROOT / "docs" / "results" / "ethercat.json"
_CYCLES: Final = 10_000
_KILLS: Final = 20
_RATIO: Final = 1.3
KICKCAT: Final = """
import os, sys, kickcat
from datetime import timedelta
os.sched_setaffinity(0, {0})
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
second = timedelta(seconds=1)
bus = kickcat.Bus(kickcat.create_link(sys.argv[1], ""))
bus.init(second)
bus.create_mapping(256)
bus.request_state(kickcat.State.SAFE_OP)
bus.wait_for_state(kickcat.State.SAFE_OP, second)
for _ in range(5):
    bus.process_data_no_check()
bus.request_state(kickcat.State.OPERATIONAL)
bus.wait_for_state(kickcat.State.OPERATIONAL, second, lambda: bus.process_data_no_check())
"""
"""Program with which KickCAT takes the drives of an interface to OP."""
_VERDICTS: Final = {
    "esi/inovance_sv660n_v9.12.xml.gz": "usable with conditions",
    "esi/ingenia_eve_xcr_e.xml.gz": "usable with conditions",
    "esi/maxon_epos4_igh_scan.xml": "only the drive can say",
    "esi/maxon_epos4_igh_scan_3axis.xml": "only the drive can say",
    "esi/pollen_orbita2d.xml": "not usable", "esi/pollen_orbita3d.xml": "not usable",
    "sii/kollmorgen_akd.bin": "only the drive can say", "sii/kollmorgen_akd_null_strings.bin": "only the drive can say",
    "sii/pollen_orbita2d.bin": "not usable", "sii/empty_eeprom_issue286.bin.gz": "damaged",
}  # fmt: skip


def scene_of(axes: int, folder: Path) -> Path:
    """Writes the demo on a line, with so many axes, all alike; returns its file."""
    path = folder / f"axes{axes}.yaml"
    path.write_text(yaml.safe_dump(on_ethercat(demo_values(axes, 1000.0))), encoding="utf-8")
    return path


@contextmanager
def _both(axes: int, folder: Path, *overrides: str) -> Iterator[tuple[FarEnd, Experiment]]:
    """Yields simulated drives behind one end of a pair, and the scene that drives them from the other."""
    scene = scene_of(axes, folder)
    with ExitStack() as stack:
        ends = stack.enter_context(veth())
        far = stack.enter_context(FarEnd(ends[1], scene, *overrides))
        given = [f"bus.interface={ends[0]}", *REALTIME, *overrides]
        yield far, stack.enter_context(build(load_scene(scene, given)))


def pysoem_start(folder: Path) -> Iterator[Row]:
    """Yields what differs between a start by pysoem and one by the thin master."""
    for axes in (1, 6):
        with _both(axes, folder) as (far, experiment):
            experiment.rig.start()
            found = far.ask()
            experiment.rig.stop()
        with build(load_scene(scene_of(axes, folder)), "free") as thin:
            assert thin.far_side is not None
            watches = [Watch(drive) for drive in thin.far_side.drives]  # type: ignore[arg-type]
            thin.rig.start()
            expected = [json.loads(json.dumps(watch.state())) for watch in watches]
            thin.rig.stop()
        pairs = list(zip(found, expected, strict=True))
        writes = sum(one["writes"] != other["writes"] for one, other in pairs)
        registers = sum(value != other["registers"][name] for one, other in pairs for name, value in
                        one["registers"].items())  # fmt: skip
        count = sum(len(of["writes"]) for of in expected)
        yield Row(f"pysoem_start: {axes} axes, drives whose CoE writes differ", writes, "", target="0", met=writes == 0,
                  note=f"{count} writes, in the same order")  # fmt: skip
        yield Row(f"pysoem_start: {axes} axes, registers (SM, FMMU, DC) that differ", registers, "", target="0",
                  met=registers == 0)  # fmt: skip


def pysoem_run(folder: Path, cycles: int) -> Iterator[Row]:
    """Yields what a run over a pair of interfaces lost, and what an exchange costs against a bare loop of pysoem."""
    for axes, rate in ((1, 1000), (6, 1000), (1, 4000), (6, 4000)):
        name, limits = f"pysoem_run: {axes} axes, {rate} Hz", ("bus.loss_limit=0.5", "bus.stop_cycles=50")
        with _both(axes, folder, f"bus.rate={rate}", "bus.watchdog=100 ms", *limits) as (_, experiment):
            done, apart, why = _run(experiment.cycle, cycles)
            line: Any = experiment.rig.buses[0]
            counts = line.statistics()
            yield Row(f"{name}: cycles run", done, f"of {cycles}", target=f"{cycles}", met=done == cycles, note=why)
            yield Row(
                f"{name}: holds by the account, less those by the drives' clock", apart, "", target="0", met=not apart
            )
            if why:
                continue
            yield Row(
                f"{name}: low counters",
                counts["low_counter"],
                "",
                target="0",
                met=counts["low_counter"] == 0,
                note=f"{counts['unanswered']} frames without answer, {counts['held']} holds without a frame",
            )
            ours, bare = _compare(line)
            experiment.rig.stop()
        yield Row(f"{name}: exchange, median", ours, "us", "bare loop of pysoem in the same run", bare, ours / bare,
                  f"ratio <= {_RATIO}", ours / bare <= _RATIO)  # fmt: skip


def _run(cycle: Cycle, cycles: int) -> tuple[int, int, str]:
    """Runs cycles with the drives enabled; returns how many, the holds counted otherwise, and what ended the run."""
    rig, line = cycle.rig, cycle.rig.buses[0]
    rig.start()
    done, apart, begun, why = 0, 0, -1, ""
    try:
        for _ in range(cycles):
            cycle.step()
            done += 1
            if all(of.is_complete for of in rig.drives):  # its hold is known by the reference clock
                offset = line._taken - rig.deadline_index  # type: ignore[attr-defined]  # noqa: SLF001
                begun = offset if begun < 0 else begun
                apart = max(apart, abs(offset - begun))
    except RigError as error:
        why = str(error)
    return done, apart, why


def _compare(line: Any, rounds: int = 1000) -> tuple[float, float]:
    """Returns the medians of our frame that writes and of a bare one [us], taken in turn while the drives run."""
    segment, master, clock = line.segment, line.segment._master, line.clock  # noqa: SLF001
    ours, bare = list[int](), list[int]()

    def timed(call: Callable[[], Any], into: list[int]) -> None:
        begin = perf_counter_ns()
        call()
        into.append(perf_counter_ns() - begin)

    def loop() -> None:
        master.send_processdata()
        master.receive_processdata(2000)

    for _ in range(rounds):
        timed(lambda: segment.exchange(FrameKind.WRITE, clock.now() + 2_000_000), ours)
        timed(loop, bare)
    return median(ours) / 1e3, median(bare) / 1e3


def pysoem_work(folder: Path, cycles: int) -> Iterator[Row]:
    """Yields the work of a cycle, and of it what a bare loop of pysoem has as well: two frames and the states."""
    for axes in (1, 6):
        with _both(axes, folder, "bus.watchdog=100 ms", "bus.loss_limit=0.5") as (_, experiment):
            rig, line = experiment.rig, cast("Any", experiment.rig.buses[0])
            rig.start()
            ours, bare, master = list[int](), list[int](), line.segment._master  # noqa: SLF001
            for _ in range(cycles):
                experiment.cycle.step()
                ours.append(sum(rig.timing[1:]))  # all but the wait for the deadline
                begin = perf_counter_ns()
                for _ in range(2):
                    master.send_processdata()
                    master.receive_processdata(2000)
                master.read_state()
                bare.append(perf_counter_ns() - begin)
            rig.stop()
        work, least = median(ours) / 1e3, median(bare) / 1e3
        yield Row(f"pysoem_work: {axes} axes, work of a cycle, median", work, "us", "bare loop of pysoem: frames alone",
                  least, work / least, note="a cycle at 4 kHz has 250 us; measured in turn at 1 kHz")  # fmt: skip


def watchdog(kills: int) -> Iterator[Row]:
    """Yields how often the torque was zero within the watchdog after the master was killed."""
    within, longest = 0, 0.0
    for _ in range(kills):
        with veth() as ends, FarEnd(ends[1]) as far:
            words = command("run", str(SCENE), *sets(f"bus.interface={ends[0]}", *REALTIME))
            master = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            for _ in range(400):
                wait(0.05)
                if far.ask()[0]["torque"] or master.poll() is not None:
                    break
            master.kill()
            master.wait()
            wait(0.1)
            [seen] = far.ask()
        silence = seen["silence"]
        within += seen["torque"] == 0.0 and seen["torques"] > 0 and silence is not None and silence <= 10_000_000
        longest = max(longest, (silence or 0) / 1e6)
    yield Row("watchdog: killed masters whose torque ended within `watchdog`", within, f"of {kills}", target=f"{kills}",
              met=within == kills, note=f"longest {longest:.3g} ms of 10 ms, by the drive's clock")  # fmt: skip


def foreign(folder: Path) -> Iterator[Row]:
    """Yields what Wireshark and KickCAT say of the frames and drives."""
    path = folder / "run.pcap"
    with veth() as ends, FarEnd(ends[1]):
        given = load_scene(SCENE, [f"bus.interface={ends[0]}", *REALTIME])
        with build(given, bus_log=path) as experiment:
            _run(experiment.cycle, 1000)
            experiment.rig.stop()
    program = shutil.which("tshark")
    assert program, "tshark is not installed"
    words = [program, "-r", str(path), "-Y", "_ws.malformed"]
    malformed = subprocess.run(words, capture_output=True, text=True, check=True).stdout.count("\n")
    frames = len(read_capture(path))
    yield Row("foreign: frames that tshark calls malformed", malformed, f"of {frames}", target="0", met=malformed == 0)
    reached = 0
    for _ in range(3):
        with veth() as ends, FarEnd(ends[1]) as far:
            words = [sys.executable, "-c", KICKCAT, ends[0]]
            done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
            reached += done.returncode == 0 and far.ask()[0]["al_state"] in (4, 8)
    yield Row("foreign: starts of KickCAT that reach OP", reached, "of 3", target="3", met=reached == 3)


def emergencies(folder: Path) -> Iterator[Row]:
    """Yields how many of six emergencies sent at once are in the log of the line."""
    path, scene = folder / "six.pcap", scene_of(6, folder)
    with veth() as ends, FarEnd(ends[1], scene) as far:
        experiment = build(load_scene(scene, [f"bus.interface={ends[0]}", *REALTIME]), bus_log=path)
        with experiment:
            experiment.rig.start()
            far.ask("fault 0x7305")
            line: Any = experiment.rig.buses[0]
            for _ in range(20):
                for place in range(6):
                    line.segment.mail(place)
            experiment.rig.stop()
    told = {of.address for _, content in read_capture(path) for of in datagrams_of(content) or ()
            if datagram_text(of).startswith("emergency 0x7305")}  # fmt: skip
    yield Row("emergencies: drives whose emergency is in the log", len(told), "of 6", target="6", met=len(told) == 6)


def captures(folder: Path) -> Iterator[Row]:
    """Yields what of the frames of a real drive is not understood."""
    frames = unknown = damaged = 0
    refused = ""
    for path in sorted(folder.glob("pcap/kollmorgen_akd*")):
        for _, content in read_capture(path):
            if content[12:14] != b"\x88\xa4":
                continue
            frames += 1
            found = datagrams_of(content)
            damaged += found is None
            for of in found or ():
                unknown += command_name(of.command) == "unknown"
                text = datagram_text(of, al_text)
                refused = text if "0x001d" in text else refused
    wrong = unknown + damaged
    yield Row("captures: frames of a Kollmorgen AKD not decoded, or with an unknown command", wrong, f"of {frames}",
              target="0 of 25552", met=wrong == 0 and frames == 25_552)  # fmt: skip
    said = "the length of the outputs is not what 0x1C12 assigns" in refused
    yield Row("captures: its refusal 0x001D in words", int(said), "", target="1", met=said, note=refused)
    started = 0
    four = "0x1C12.0: 4, 0x1C12.1: 0x1600, 0x1C12.2: 0x1601, 0x1C12.3: 0x1602, 0x1C12.4: 0x1603"
    with build(load_scene(SCENE, [f"simulation.drive.objects={{0x6502: 0x200, {four}}}"]), "free") as twin:
        twin.rig.start()
        assert twin.far_side is not None
        count = twin.far_side.drives[0].store.find(0x1C12)
        started += count is not None and count.number == 1
        twin.rig.stop()
    yield Row(
        "captures: its twin, which assigns four RxPDOs, starts with one", started, "", target="1", met=started == 1
    )


def esi(folder: Path, scratch: Path) -> Iterator[Row]:
    """Yields how many files of vendors have the verdict that follows from reading them by hand."""
    right, wrong = 0, list[str]()
    for name, expected in _VERDICTS.items():
        path = folder / name
        try:
            devices = (read_sii(path),) if is_sii(path) else esi_devices(path)
            seen = choose([judge(path, device) for device in devices], path, None).judgement.value
        except DictionaryError:
            seen = "damaged"
        right += seen == expected
        wrong += [f"{name}: {seen}"] * (seen != expected)
    yield Row("esi: files of vendors with the right verdict", right, f"of {len(_VERDICTS)}", target=f"{len(_VERDICTS)}",
              met=not wrong, note="; ".join(wrong))  # fmt: skip
    path = scratch / "two.xml"
    path.write_text(make_two_revisions(), encoding="utf-8")
    verdicts = [judge(path, device) for device in esi_devices(path)]
    found = [choose(verdicts, path, revision).judgement.value for revision in (1, 0x10420)]
    both = found == ["not usable", "usable with conditions"]
    yield Row("esi: one file, two revisions, two verdicts", int(both), "", target="1", met=both)


def with_recorded(rows: list[Row]) -> list[Row]:
    """Returns rows in the place of those of the same kind that were recorded last, which is the name before the colon.

    Args:
        rows: Rows of some kinds.
    """
    path = out_folder() / "ethercat.json"
    path = path if path.is_file() else _RECORDED
    recorded = json.loads(path.read_text(encoding="utf-8"))["rows"] if path.is_file() else []
    of_kind = dict[str, list[Row]]()
    for row in (Row(**of) for of in recorded):
        of_kind.setdefault(row.row.partition(":")[0], []).append(row)
    for kind in {row.row.partition(":")[0]: None for row in rows}:
        of_kind[kind] = [row for row in rows if row.row.partition(":")[0] == kind]
    return [row for several in of_kind.values() for row in several]


def main() -> None:
    """Measures and publishes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a tenth of the cycles and of the kills")
    parser.add_argument("--only", nargs="+", default=[], metavar="KIND", help="name of rows before the colon")
    given = parser.parse_args()
    part = 10 if given.quick else 1
    folder = Path(os.environ.get("CANHAPTIC_CAPTURES", ""))
    with tempfile.TemporaryDirectory() as made:
        scratch = Path(made)
        kinds: dict[str, Callable[[], Iterator[Row]]] = {
            "pysoem_start": lambda: pysoem_start(scratch),
            "foreign": lambda: foreign(scratch),
            "emergencies": lambda: emergencies(scratch),
            "captures": lambda: captures(folder),
            "esi": lambda: esi(folder, scratch),
            "watchdog": lambda: watchdog(max(2, _KILLS // part)),
            "pysoem_run": lambda: pysoem_run(scratch, _CYCLES // part),
            "pysoem_work": lambda: pysoem_work(scratch, 2_000),
        }
        if folder == Path() or not folder.is_dir():
            kinds = {name: of for name, of in kinds.items() if name not in ("captures", "esi")}
        if unknown := [kind for kind in given.only if kind not in kinds]:
            parser.error(f"--only: got {', '.join(unknown)}, expected some of: {', '.join(kinds)}")
        rows = [row for kind in given.only or kinds for row in kinds[kind]()]
    publish("ethercat", with_recorded(rows), ["canhaptic", "numpy", "pysoem", "kickcat"])


if __name__ == "__main__":
    main()

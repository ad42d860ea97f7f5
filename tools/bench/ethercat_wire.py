"""What does a foreign master on a wire cost, and does a run by it end as long as it should?

pysoem drives the simulated drives over a veth pair: needs root and pysoem. Its rows are added to those of the question
`ethercat`. Starts, watchdog, Wireshark, KickCAT, captures and ESIs of vendors are in `tests/wire` and `tests/drive`.
Times are compared side by side in one run: they are those of a shared computer. `--quick` does a tenth of the cycles,
and `--only` some kinds of rows; the others stay as they were recorded.
"""

import argparse
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median
from time import perf_counter_ns
from typing import Any, Final, cast

import yaml

from canhaptic.cycle import Cycle
from canhaptic.drive.ethercat.segment import FrameKind
from canhaptic.errors import RigError
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import load_scene
from tests.wire.veth import REALTIME, FarEnd, veth
from tools.bench.demo import demo_values
from tools.bench.report import Row, publish, rows_of_kinds
from tools.on_ethercat import on_ethercat

_CYCLES: Final = 10_000
_RATIO: Final = 1.3


def scene_of(axes: int, folder: Path) -> Path:
    """Writes the demo on a line, with so many axes, all alike; returns its file."""
    path = folder / f"axes{axes}.yaml"
    path.write_text(yaml.safe_dump(on_ethercat(demo_values(axes, 1000.0))), encoding="utf-8")
    return path


@contextmanager
def _on_a_pair(axes: int, folder: Path, *overrides: str) -> Iterator[Experiment]:
    """Yields the scene that drives simulated drives behind the other end of a pair."""
    scene = scene_of(axes, folder)
    with ExitStack() as stack:
        ends = stack.enter_context(veth())
        stack.enter_context(FarEnd(ends[1], scene, *overrides))
        given = [f"bus.interface={ends[0]}", *REALTIME, *overrides]
        yield stack.enter_context(build(load_scene(scene, given)))


def pysoem_run(folder: Path, cycles: int) -> Iterator[Row]:
    """Yields what a run over a pair of interfaces lost, and what an exchange costs against a bare loop of pysoem."""
    for axes, rate in ((1, 1000), (6, 1000), (1, 4000), (6, 4000)):
        name, limits = f"pysoem_run: {axes} axes, {rate} Hz", ("bus.loss_limit=0.5", "bus.stop_cycles=50")
        with _on_a_pair(axes, folder, f"bus.rate={rate}", "bus.watchdog=100 ms", *limits) as experiment:
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
        with _on_a_pair(axes, folder, "bus.watchdog=100 ms", "bus.loss_limit=0.5") as experiment:
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


def main() -> None:
    """Measures and publishes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a tenth of the cycles")
    parser.add_argument("--only", nargs="+", default=[], metavar="KIND", help="name of rows before the colon")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        kinds: dict[str, Callable[[], Iterator[Row]]] = {
            "pysoem_run": lambda: pysoem_run(Path(made), _CYCLES // (10 if given.quick else 1)),
            "pysoem_work": lambda: pysoem_work(Path(made), 2_000),
        }
        rows = rows_of_kinds("ethercat", kinds, parser, given.only)
    publish("ethercat", rows, ["canhaptic", "numpy", "pysoem"])


if __name__ == "__main__":
    main()

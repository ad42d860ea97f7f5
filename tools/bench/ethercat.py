"""Does the account on EtherCAT tell the truth, and what does a line cost against CAN?

Simulated drives down to the bytes, in virtual time: random scenes judged by the plant's own energy (kept in
`ethercat_truth_runs.jsonl`, so that the same command goes on where it was stopped), processor time of a cycle against
CAN, twins that are commissioned, and lines of code. One scene on both buses, holds and counts, the phase lock, replay,
derivation and mutated frames are in `tests`. `--quick` does a hundredth of the campaigns, and `--only` some kinds of
rows; the others stay as recorded.
"""

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from math import inf
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any, Final

from canhaptic.scene.build import build
from canhaptic.scene.load import scene_from_mapping
from canhaptic.scene.models import Scene
from tools.bench.commission_line import WANTED as TWINS
from tools.bench.commission_line import rows as commissioned
from tools.bench.demo import CONFIG, demo_values
from tools.bench.report import Row, kept_folder, publish, rows_of_kinds
from tools.bench.truth import is_false
from tools.count_structure import code_of, modules_of
from tools.kept_runs import run_kept
from tools.on_ethercat import on_ethercat
from tools.truth.ethercat import outcome_of
from tools.truth.judge import Outcome

_ROOT: Final = Path(__file__).resolve().parents[2]
_SCENES: Final = 2_000
_DRAWN: Final = 2_300  # some are refused, and some declare what is false
_PRODUCT: Final = ("drive.ethercat", "sim.drive.ethercat", "scene.buses", "canopen.esi", "logs.frame_log")
_OF_THE_WIRE: Final = ("with_pysoem", "esi_survey", "served_line", "esi")
"""Modules of it that a simulated line needs no more than its description: foreign masters, vendors' files."""
_RATIO: Final = 1.5
_FAST: Final = 4_000  # [Hz]
_BLOCK: Final = 50  # cycles
_LINES: Final = 2_700


def truth(scenes: int, jobs: int, minutes: float) -> Iterator[Row]:
    """Yields the false claims of random scenes whose declarations are true."""
    kept = kept_folder() / "ethercat_truth_runs.jsonl"
    found = run_kept(_outcome, range(scenes), kept, jobs, minutes=minutes)
    outcomes = [Outcome.from_json(of) for of in found.values()]
    true = [of for of in outcomes if of.status != "refused" and not any(tag.startswith("false:") for tag in of.tags)]
    false, counted = sum(map(is_false, true)), len(true)
    note = f"{sum('bus:both' in of.tags for of in true)} of them groups across EtherCAT and CAN"
    yield Row("truth: scenes with a false claim", false, f"of {counted}", target="0", met=false == 0, note=note)
    yield Row("truth: scenes run", counted, "", target=f">= {_SCENES}", met=counted >= _SCENES)


def _outcome(seed: int) -> dict[str, Any]:
    return outcome_of(seed).as_json()


def virtual_time(blocks: int) -> Iterator[Row]:
    """Yields the processor time of a cycle at 4 kHz, and next to it that on CAN, at the rate that its bus carries."""
    for axes, rate in ((1, 1000), (6, 250)):
        values = demo_values(axes, rate)
        fast = on_ethercat(demo_values(axes, _FAST))
        can, ethercat = _costs([scene_from_mapping(of, str(CONFIG)) for of in (values, fast)], blocks)
        ratio = median(one / other for one, other in zip(ethercat, can, strict=True))
        yield Row(f"virtual_time: {axes} axes", 1e6 * median(ethercat), "us", "the same on CAN", 1e6 * median(can),
                  ratio, f"ratio <= {_RATIO}", ratio <= _RATIO,
                  note=f"{_FAST} Hz, CAN at {rate} Hz; medians of {blocks} blocks in turn")  # fmt: skip


def _costs(scenes: Sequence[Scene], blocks: int) -> list[list[float]]:
    """Returns the processor time of a cycle of each scene [s], in blocks that take turns."""
    spent = [list[float]() for _ in scenes]
    with ExitStack() as stack:
        experiments = [stack.enter_context(build(scene, "free")) for scene in scenes]
        for experiment in experiments:
            experiment.rig.start()
        for block in range(blocks + 1):
            for costs, experiment in zip(spent, experiments, strict=True):
                step, begin = experiment.cycle.step, process_time()
                for _ in range(_BLOCK):
                    step()
                if block:  # the first warms up
                    costs.append((process_time() - begin) / _BLOCK)
        for experiment in experiments:
            experiment.rig.stop()
    return spent


def size() -> Iterator[Row]:
    """Yields the lines of code."""
    names = [of.name for of in modules_of(_ROOT) if of.name.removeprefix("canhaptic.").startswith(_PRODUCT)]
    own = code_of(_ROOT, (name for name in names if name.rpartition(".")[2] not in _OF_THE_WIRE))
    note = f"{code_of(_ROOT, names)} with {', '.join(_OF_THE_WIRE)}"
    yield Row("size: lines of code", own, "", target=f"<= {_LINES}", met=own <= _LINES, note=note)


def main() -> None:
    """Measures and publishes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a hundredth of the campaigns")
    parser.add_argument("--minutes", type=float, default=inf, help="time for random scenes that are not kept yet")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes of the random scenes")
    parser.add_argument("--only", nargs="+", default=[], metavar="KIND", help="name of rows before the colon")
    given = parser.parse_args()
    part = 100 if given.quick else 1
    kinds: dict[str, Callable[[], Iterator[Row]]] = {
        "truth": lambda: truth(max(10, _DRAWN // part), given.jobs, given.minutes),
        "virtual_time": lambda: virtual_time(100),
        "commission": lambda: commissioned(max(2, TWINS // part)),
        "size": size,
    }
    publish("ethercat", rows_of_kinds("ethercat", kinds, parser, given.only), ["canhaptic", "numpy"])


if __name__ == "__main__":
    main()

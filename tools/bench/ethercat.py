"""Is a scene on EtherCAT the same scene, with the same account, as on CAN, and what does it cost?

Simulated drives down to the bytes, in virtual time. Rows: one scene on both buses; the hold in which a torque acts
against the one that the account uses; three counts of held torques; random scenes judged by the plant's own energy
(kept in `ethercat_truth_runs.jsonl`, so that the same command goes on where it was stopped); the phase lock; processor
time of a cycle against CAN; a replay; accounts derived from captures; twins that are commissioned; mutated frames; and
the size. `--quick` does a hundredth of the campaigns, and `--only` some kinds of rows; the others stay as recorded.
"""

import argparse
import os
import random
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from math import inf
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any, Final

from canhaptic.audit.recompute import Rederived, rederive
from canhaptic.cycle import run
from canhaptic.drive.ethercat.phase_lock import PhaseLock
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.frame_log import FrameLog, LoggedFrame, RecordedLine, ReplayDepartureError, read_frame_log
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import scene_from_mapping
from canhaptic.scene.models import Scene
from tests.drive.ethercat.rig_bench import Bench
from tests.sim_drive.ethercat_fuzz import attack_drives, attack_master
from tests.sim_drive.test_ethercat_counts import KINDS, isolated, line_with, obeys
from tools.bench.commission_line import WANTED as TWINS
from tools.bench.commission_line import rows as commissioned
from tools.bench.demo import CONFIG, IN_CONTACT, demo_values
from tools.bench.ethercat_wire import with_recorded
from tools.bench.report import Row, kept_folder, publish
from tools.bench.truth import is_false
from tools.kept_runs import run_kept
from tools.on_ethercat import on_ethercat, torques_of, true_energies
from tools.truth.ethercat import outcome_of
from tools.truth.judge import Outcome

_ROOT: Final = Path(__file__).resolve().parents[2]
_CYCLES: Final = 10_000
_NS: Final = 1_000_000  # [ns]
_PPM: Final = (-100, -50, -10, 0, 10, 50, 100)
_LONG: Final = 20_000  # cycles of the isolated faults
_SEEDS: Final = 200
_SCENES: Final = 2_000
_DRAWN: Final = 2_300  # some are refused, and some declare what is false
_FRAMES: Final = 1_000_000
_ANSWERS_A_RUN: Final = 120  # of the attack on the master, about
_PRODUCT: Final = (
    *("canhaptic/drive/ethercat", "canhaptic/sim/drive/ethercat", "canhaptic/scene/buses.py"),
    *("canhaptic/canopen/esi.py", "canhaptic/logs/frame_log.py"),
)
_OF_THE_WIRE: Final = ("with_pysoem.py", "esi_survey.py", "served_line.py", "esi.py")
"""Files of it that a simulated line needs no more than its description: foreign masters, vendors' files."""
_RATIO: Final = 1.5
_FAST: Final = 4_000  # [Hz]
_BLOCK: Final = 50  # cycles
_WITHIN: Final = 50  # cycles
_LINES: Final = 2_700


def _run(experiment: Experiment, cycles: int) -> tuple[list[tuple[float, ...]], list[float]]:
    with experiment:
        return torques_of(experiment, cycles), true_energies(experiment)


def _on_both(values: dict[str, Any], changes: Sequence[str] = ()) -> list[Scene]:
    """Returns a scene on its CAN bus and on a line."""
    return [scene_from_mapping(of, str(CONFIG), changes) for of in (values, on_ethercat(values))]


def same_scene(cycles: int) -> Iterator[Row]:
    """Yields the differences of one scene on both buses."""
    can, ethercat = (_run(build(scene, "free"), cycles) for scene in _on_both(demo_values(1, 1000.0), IN_CONTACT))
    differing = sum(one != other for one, other in zip(can[0], ethercat[0], strict=True))
    apart = max(abs(one - other) for one, other in zip(can[1], ethercat[1], strict=True))
    yield Row("same_scene: torques that differ in a bit", differing, "", target="0", met=differing == 0)
    yield Row("same_scene: largest difference of an energy", apart, "J", target="<= 1e-12", met=apart <= 1e-12)


def delay() -> Iterator[Row]:
    """Yields how often the hold in which a torque acts is the one that the account uses."""
    agree = 0
    for frames in (1, 2):
        for pipeline, quirks in enumerate(((), ("acts_a_sync_late",), ("acts_two_syncs_late",))):
            bench = Bench(frames=frames, drive={"syncs_late": pipeline}, axis={"quirks": quirks})
            bench.rig.start()
            shown = []
            for k in range(12):
                shown.append(bench.drives[0].torque if k else 0.0)
                bench.rig.sync()
                shown[-1] = bench.drives[0].torque
                bench.rig.write_torques([5.0 if k == 3 else 0.0])
            acts = next((k for k, torque in enumerate(shown) if torque), -1)
            agree += acts - 3 == bench.axes[0].delay
            bench.rig.stop()
    yield Row("delay: holds that agree", agree, "of 6", target="6", met=agree == 6)


def counts(cycles: int, seeds: int) -> Iterator[Row]:
    """Yields whether the counts of held torques obey their law."""
    faults = isolated(cycles, 0.05, seed=4)
    line = line_with(faults, cycles)
    answers = list(faults.values()).count(KINDS[2])
    exact = line.missed == len(faults) and all(line.missed_by(n) == line.missed - answers for n in range(2))
    yield Row(f"counts: isolated faults of {cycles} cycles counted exactly", int(exact), "", target="1", met=exact)
    held = 0
    for seed in range(seeds):
        dice = random.Random(seed)
        held += obeys(line_with({k: dice.choice(KINDS) for k in range(250) if dice.random() < 0.3}, 250))
    yield Row("counts: seeds that obey the law", held, f"of {seeds}", target=f"{seeds}", met=held == seeds)
    caught = not obeys(line_with({}, 300, drift_ppb=2_000_000, has_servo=False))
    yield Row("counts: a drive without drift servo is caught", int(caught), "", target="1", met=caught)


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


def lock() -> Iterator[Row]:
    """Yields after how many cycles the host is within 5 % of the period, from any phase."""
    slowest = max(_cycles_to_lock(ppm, phase) for ppm in _PPM for phase in range(0, _NS, _NS // 40))
    yield Row("lock: cycles until within 5 %", slowest, "", target=f"<= {_WITHIN}", met=slowest <= _WITHIN)


def _cycles_to_lock(ppm: int, phase: int) -> int:
    lock, target, last = PhaseLock(_NS, _NS // 4), _NS // 4, -1
    lock.begin(0)
    now = float(phase)
    for k in range(500):
        error = (now - target + _NS / 2) % _NS - _NS / 2
        if abs(error) > 0.05 * _NS:
            last = k
        now += (_NS - lock.follow(round(now))) * (1.0 + ppm * 1e-6)
    return last + 1


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


def replay(cycles: int) -> Iterator[Row]:
    """Yields whether every frame of a run is sent again, and whether a flipped bit is named."""
    _, scene = _on_both(demo_values(1, 1000.0), IN_CONTACT)
    with TemporaryDirectory() as folder:
        log = Path(folder) / "run.pcap"
        _run(build(scene, "free", bus_log=log), cycles)
        frames = read_frame_log(log)
        played = _play(scene, frames, cycles)
    sent = sum(not frame.is_answer for frame in frames)
    whole = played.left == 0 and played.compared == sent
    yield Row("replay: frames sent again byte for byte", played.compared, "", target=f"{sent}", met=whole)
    answer = next(n for n in range(len(frames) * 2 // 3, len(frames)) if frames[n].content[50] == 10
                  and frames[n].is_answer)  # fmt: skip
    changed = bytearray(frames[answer].content)
    changed[63] ^= 0x40
    frames[answer] = frames[answer]._replace(content=bytes(changed))
    try:
        _play(scene, frames, cycles)
        named = ""
    except ReplayDepartureError as error:
        named = str(error)
    yield Row("replay: one flipped bit is named", int(bool(named)), "", target="1", met=bool(named), note=named)


def derived(runs: int, flips: int) -> Iterator[Row]:
    """Yields whether captures alone give the logged account, with frames lost at random; what a flipped bit does."""
    equal, dice = 0, random.Random(11)
    with TemporaryDirectory() as made:
        for seed in range(runs):
            shares = {name: dice.choice((0.0, 0.003, 0.03)) for name in ("late", "lost", "answer_lost", "low_counter")}
            values = on_ethercat(demo_values(dice.randint(1, 3), 1000.0), {"drift": 4e-5, **shares}, loss_limit=1.0,
                                 stop_cycles=50, frames=dice.choice((1, 2, 2)))  # fmt: skip
            found = _derived(scene_from_mapping(values, str(CONFIG), [*IN_CONTACT[:1], f"simulation.seed={seed}"]),
                             Path(made))  # fmt: skip
            equal += not found["differences"] and not found["damage"]
        yield Row("derived: captures that give the logged account bit for bit", equal, f"of {runs}", target=f"{runs}",
                  met=equal == runs)  # fmt: skip
        scene, log = _on_both(demo_values(1, 1000.0), IN_CONTACT)[1], Path(made) / "run.pcap"
        _derived(scene, Path(made))
        frames, named = read_frame_log(log), 0
        places = [n for n in range(len(frames) * 2 // 3, len(frames) - 400)
                  if frames[n].is_answer and frames[n].content[50] in (10, 11)]  # fmt: skip
        for place in dice.sample(places, flips):
            begin, end = (60, 64) if frames[place].content[50] == 11 else (62, 68)  # outputs; position and torque
            changed = bytearray(frames[place].content)
            changed[dice.randrange(begin, end)] ^= 1 << dice.randrange(8)
            other = [*frames[:place], frames[place]._replace(content=bytes(changed)), *frames[place + 1 :]]
            named += _is_named(scene, other, Path(made))
        name = "derived: flipped bits of position, torque or outputs that are named"
        yield Row(name, named, f"of {flips}", target=f"{flips}", met=named == flips)


def _derived(scene: Scene, folder: Path) -> Rederived:
    """Runs a scene with both logs; returns the account from its capture."""
    energy, bus = folder / "run.h5", folder / "run.pcap"
    energy.unlink(missing_ok=True)
    with build(scene, "free", energy, bus) as experiment:
        experiment.run_through(800, lambda: False)
    with EnergyLog.open(energy) as log:
        return rederive(bus, scene, log)


def _is_named(scene: Scene, frames: list[LoggedFrame], folder: Path) -> bool:
    """Returns whether something is said of a capture with these frames."""
    bus = folder / "changed.pcap"
    with FrameLog(bus) as changed:
        for frame in frames:
            changed.note(frame.time, frame.content)
    with EnergyLog.open(folder / "run.h5") as log:
        found = rederive(bus, scene, log)
    return bool(found["differences"] or found["damage"])


def _play(scene: Scene, frames: list[LoggedFrame], cycles: int) -> RecordedLine:
    experiment = Experiment(scene, "free", None, None, recorded=frames)
    with experiment:
        run(experiment.cycle, cycles)
    assert experiment.played is not None
    return experiment.played


def fuzz(frames: int) -> Iterator[Row]:
    """Yields what mutated frames do; an exception or a hang ends the benchmark."""
    torques = attack_drives(frames, seed=7)
    name = "fuzz: mutated frames that left a torque that was not asked for"
    yield Row(name, torques, f"of {frames}", target="0", met=torques == 0)
    answers = attack_master(max(1, frames // _ANSWERS_A_RUN), seed=7)
    yield Row("fuzz: answers to the master, some mutated", answers, "", target=f">= {frames}", met=answers >= frames)


def size() -> Iterator[Row]:
    """Yields the lines of code, and whether a rig on CAN loads any of them."""
    lines = wire = 0
    for name in _PRODUCT:
        path = _ROOT / name
        for file in [path] if path.is_file() else sorted(path.glob("*.py")):
            lines += _code_lines(file)
            wire += _code_lines(file) if file.name in _OF_THE_WIRE else 0
    own, note = lines - wire, f"{lines} with {', '.join(_OF_THE_WIRE)}"
    yield Row("size: lines of code", own, "", target=f"<= {_LINES}", met=own <= _LINES, note=note)
    program = (
        "import sys, canhaptic; canhaptic.simulate(sys.argv[1], {'duration': 0.05});"
        "print(sum('ethercat' in name for name in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program, str(CONFIG)], capture_output=True, text=True, check=True,
                          cwd=_ROOT)  # fmt: skip
    loaded = int(done.stdout.split()[-1])
    yield Row("size: modules of EtherCAT that a rig on CAN loads", loaded, "", target="0", met=loaded == 0)


def _code_lines(path: Path) -> int:
    """Returns the lines of a module without blank ones, comments and docstrings."""
    import ast

    text = path.read_text(encoding="utf-8")
    quoted = set[int]()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            quoted |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    numbered = enumerate(text.splitlines(), 1)
    return sum(bool(line.strip()) and not line.lstrip().startswith("#") and n not in quoted for n, line in numbered)


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
        "same_scene": lambda: same_scene(max(2_000, _CYCLES // part)),
        "delay": delay,
        "counts": lambda: counts(_LONG // part, max(5, _SEEDS // part)),
        "truth": lambda: truth(max(10, _DRAWN // part), given.jobs, given.minutes),
        "lock": lock,
        "virtual_time": lambda: virtual_time(100),
        "replay": lambda: replay(3_000),
        "derived": lambda: derived(max(2, 20 // part), max(4, 40 // part)),
        "commission": lambda: commissioned(max(2, TWINS // part)),
        "fuzz": lambda: fuzz(_FRAMES // part),
        "size": size,
    }
    if unknown := [kind for kind in given.only if kind not in kinds]:
        parser.error(f"--only: got {', '.join(unknown)}, expected some of: {', '.join(kinds)}")
    rows = [row for kind in given.only or kinds for row in kinds[kind]()]
    publish("ethercat", with_recorded(rows), ["canhaptic", "numpy"])


if __name__ == "__main__":
    main()

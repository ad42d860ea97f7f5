"""What do two rigs over a network give out, what is felt, and what does a packet cost?

First random networks on loops without a bus (`tools.attack.far`, plants and network of its own), then every line of the
rule broken in turn, then pairs over the product's buses by the truth of both plants, the spring on a wall, and the
processor time of a packet. What was attacked is kept in `far_worlds_runs.jsonl`: the same command goes on with it.
Last come the rows of a slow program behind a rig (`slow_worlds.py`). `--only` measures some kinds of
rows (`--only worlds`), and leaves the others as recorded.
"""

import argparse
import os
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import thread_time
from typing import Final

import numpy as np

from canhaptic.cycle import running
from canhaptic.far.packet import READY
from canhaptic.far.session import Session
from canhaptic.far.udp import UdpLink
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.scene.pair import Pair
from tools.attack.far import FALSE, GIVEN, MUTANTS, first_false, outcome
from tools.bench.report import Row, kept_folder, publish, rows_of_kinds
from tools.bench.slow_worlds import rows_of_worlds
from tools.kept_runs import run_kept

_PACKAGES: Final = ("canhaptic", "numpy", "numba")
_LENGTH: Final = 2.0  # of a network [s]
_WITHIN: Final = 300
_SERIES: Final = 1000.0 * 5000.0 / (1000.0 + 5000.0)  # both springs [N/m]
_FASTEST: Final = 0.06 * 2.0 * np.pi * 0.5  # of the hand of `by_model` [m/s]
CELLS: Final = ((0.0, 0.0), (10.0, 5.0), (40.0, 0.0), (40.0, 20.0), (100.0, 0.0), (300.0, 0.0), (300.0, 20.0))
"""Round trips [ms] and losses [%]."""
_HAND: Final = "configs/far_hand.yaml"
_WALL: Final = "configs/far_wall.yaml"


def networks(wanted: int, minutes: float, jobs: int) -> list[Row]:
    """Returns the rows of the random networks."""
    kept = kept_folder() / "far_worlds_runs.jsonl"
    found = [
        came
        for came in run_kept(partial(outcome, length=_LENGTH), range(wanted), kept, jobs, minutes=minutes).values()
        if came[2] > 0.0
    ]
    false = sum(worst < FALSE for worst, _, _ in found)
    share = sum(alone < GIVEN for _, alone, _ in found) / max(1, len(found))
    return [
        Row("random networks with torque", len(found), "1", target=">= 20000", met=len(found) >= 20_000),
        Row("of these false", false, "1", target="0", met=not false),
        Row("least energy over them, one side or both", min((one[0] for one in found), default=0.0), "J"),
        Row("one side gave out 1 mJ of the other's", share, "1", target=">= 0.3", met=share >= 0.3),
    ]


def mutants() -> list[Row]:
    """Returns after how many networks each wrong line of the rule is found."""
    rows = []
    for name, number in MUTANTS.items():
        found = first_false(partial(outcome, length=4.0, mutant=number), range(1, _WITHIN + 1))
        value = found or _WITHIN
        rows.append(Row(f"mutant: {name}", value, "networks", target=f"<= {_WITHIN}", met=found is not None))
    return rows


def bus_pair(seed: int) -> tuple[float, float, float]:
    """Returns what a random pair gave out, by the truth of both plants, what one side gave, and what crossed [J]."""
    random = np.random.default_rng([7, seed])
    delay, loss = random.choice([0.0, 2.0, 10.0, 30.0]), random.choice([0.0, 1.0, 20.0])
    stiffness = 10.0 ** random.uniform(1.8, 2.8)
    spring = f"{{type: spring, stiffness: {stiffness:.4g} N/m, damping: {0.02 * stiffness + 4.0:.4g} N*s/m}}"
    common = [f"far.coupling={spring}", f"far.level={random.uniform(15.0, 60.0):.4g} mJ"]
    way = f"{{delay: {delay} ms, jitter: {0.1 * delay} ms, loss: {loss} %, burst: 3, double: 5 %}}"
    own = [
        f"simulation.far_network={way}", f"simulation.seed={seed}",
        f"simulation.user.motion.frequency={random.uniform(0.4, 1.5):.4g} Hz",
        f"simulation.user.motion.amplitude={random.uniform(20.0, 60.0):.4g} mm",
    ]  # fmt: skip
    lost = ["simulation.bus.drop=0.01", "passivity.max_consecutive_losses=1"]
    wall = [*(lost if random.random() < 0.5 else []), "far.level=60 mJ"]
    scenes = load_scene(_HAND, [*common, *own]), load_scene(_WALL, [*common, *wall])
    outcome = Pair(scenes).run_through(2.5, lambda: False)
    sides = [result["truth"]["handle"]["least_interaction"] for result in outcome.results]
    gave = min(port["in"] - port["out"] for port in (result["ports"]["handle"] for result in outcome.results))
    return min(outcome.pair["least_true"], *sides), gave, max(outcome.pair["sent"])


def over_buses(wanted: int, minutes: float, jobs: int) -> list[Row]:
    """Returns the rows of the random pairs over the product's buses."""
    kept = kept_folder() / "far_worlds_pairs.jsonl"
    found = list(run_kept(bus_pair, range(wanted), kept, jobs, minutes=minutes).values())
    pairs, least = len(found), min((one[0] for one in found), default=0.0)
    gave = sum(one[1] < GIVEN for one in found)
    return [
        Row("random pairs over the buses", pairs, "1", target=">= 500", met=pairs >= 500),
        Row("least energy over them, by the plants", least, "J", target=">= -1e-9", met=least >= FALSE),
        Row("of these, 1 mJ crossed", sum(one[2] > -GIVEN for one in found) / max(1, pairs), "1"),
        Row("of these, one side gave out 1 mJ of the other's", gave / max(1, pairs), "1"),
    ]


def felt(round_trip: float) -> Row:
    """Returns what the hand feels of a wall behind the spring at a round trip [ms]."""
    changes = [
        f"simulation.far_network={{delay: {0.5 * round_trip} ms, jitter: {0.05 * round_trip} ms}}",
        "simulation.user.motion.amplitude=60 mm", "far.coupling.damping=8 N*s/m",
    ]  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.h5"
        Pair((load_scene(_HAND, changes), load_scene(_WALL)), (path, None)).run_through(5.0, lambda: False)
        with EnergyLog.open(path) as log:
            position, torque = log.ports["handle"]["position"], log.ports["handle"]["torque_applied"]
    there = position[4000:]
    pressed = there > 0.999 * there.max()
    stiffness = float(np.mean(-torque[4000:][pressed] / (there[pressed] - 0.03)))
    met, name = abs(stiffness / _SERIES - 1.0) <= 0.02, f"spring, round trip {round_trip:g} ms"
    return Row(f"{name}: felt", stiffness, "N/m", target="833 +- 2 %", met=met)


def by_model(round_trip: float, loss: float) -> list[Row]:
    """Returns what the hand feels of a wall that the other rig has found, at a round trip [ms] and a loss [%]."""
    way = f"{{delay: {0.5 * round_trip} ms, jitter: {0.05 * round_trip} ms, loss: {loss} %, burst: 3}}"
    model = "far.coupling={type: model, stiffness: 2 kN/m, damping: 8 N*s/m}"
    with tempfile.TemporaryDirectory() as folder:
        paths, hand = [Path(folder) / name for name in ("a.h5", "b.h5")], Path(folder) / "hand.csv"
        moves = np.minimum(np.arange(7200) * 1e-3, 7.0)  # three and a half periods, and rest
        np.savetxt(hand, np.c_[np.arange(7200) * 1e-3, 0.06 * np.sin(np.pi * moves)], delimiter=",")
        changes = [f"simulation.far_network={way}", f"simulation.user.motion={{type: recorded, file: {hand}}}", model]
        scenes = load_scene(_HAND, [*changes, "far.silence=2 s"]), load_scene(_WALL, ["far.silence=2 s"])
        outcome = Pair(scenes, paths).run_through(9.0, lambda: False)
        with EnergyLog.open(paths[0]) as log, EnergyLog.open(paths[1]) as other:
            position, torque = log.ports["handle"]["position"], log.ports["handle"]["torque_applied"]
            apart = float(abs(position[-1] - other.ports["handle"]["position"][-1]))
    there, applied, name = position[6000:7000], torque[6000:7000], f"model, {round_trip:g} ms, {loss:g} % lost"
    pressed = there > 0.999 * there.max()
    touch = float(np.mean(-applied[pressed] / (there[pressed] - 0.03)))
    drag, given = float(np.sqrt(np.mean(torque[3100:3900] ** 2))), outcome.pair["least_true"]
    of_touch = f"{name}: felt at the last touch, 2 kN/m asked"
    return [
        Row(of_touch, touch, "N/m", target=">= 1500", met=touch >= 1500.0),
        Row(f"{name}: drag in free motion, rms", drag, "N", target="<= 0.5", met=drag <= 0.5),
        Row(f"{name}: apart at the end", apart, "m", target="<= 1e-5", met=apart <= 1e-5),
        Row(f"{name}: least energy of both plants", given, "J", target=">= -1e-9", met=given >= FALSE),
    ]


def first_touch(round_trip: float, asked: float, seeds: int = 10) -> list[Row]:
    """Returns what is felt of a wall at its first touch, at a round trip [ms], and how its torque begins: medians."""
    felt, jumps, drag = [], [], 4.0 * _FASTEST
    model = "far.coupling={type: model, stiffness: 2 kN/m, damping: 8 N*s/m}"
    for seed in range(seeds):
        way = f"{{delay: {0.5 * round_trip} ms, jitter: {0.05 * round_trip} ms}}"
        changes = [f"simulation.far_network={way}", "simulation.user.motion.amplitude=60 mm", "far.silence=2 s", model]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.h5"
            scenes = load_scene(_HAND, [*changes, f"simulation.seed={seed}"]), load_scene(_WALL, ["far.silence=2 s"])
            Pair(scenes, (path, None)).run_through(2.7, lambda: False)
            with EnergyLog.open(path) as log:
                position, torque = log.ports["handle"]["position"], log.ports["handle"]["torque_applied"]
        turns, inward = slice(2400, 2600), np.flatnonzero(position[2100:] > 0.03)[0] + 2100
        felt.append(float(np.mean(-torque[turns]) / np.mean(position[turns] - 0.03)))
        jumps.append(float(np.abs(np.diff(torque[inward:2600])).max()))
    value, jump, name = float(np.median(felt)), float(np.median(jumps)), f"model, {round_trip:g} ms, first touch"
    return [
        Row(f"{name}: felt in the 0.2 s in which the hand turns", value, "N/m", target=f">= {asked:g}",
            met=value >= asked),
        Row(f"{name}: largest step of the torque", jump, "N", target=f"<= {drag:.3g} (drag)", met=jump <= drag),
    ]  # fmt: skip


def flood() -> Row:
    """Returns by how much 100 packets a SYNC from the peer's address, of the session and badly tagged, lengthen one."""
    places = ("127.0.0.1", 47813), ("127.0.0.1", 47814)
    link, peer = UdpLink(*places), UdpLink(*reversed(places))
    rig, forged = build(load_scene(_HAND, ["far.silence=10 s"]), "free", to_far=(link, None)), bytes(80)
    took: tuple[list[float], list[float]] = [], []
    other = Session(b"", 10**6, 1e15, iter(range(1, 100)).__next__, peer.send)
    with rig, running(rig.cycle):
        for cycle in range(6000):
            other.pass_time(1)
            for data in peer.arrived():
                other.take(data, may_begin=True)
                forged = data[:16] + bytes(64)
            is_flood = cycle // 100 % 2
            for _ in range(100 * is_flood):
                peer.send(forged)
            other.say((READY, 0, 0, 10**9 * cycle, 0, 0, 0.0, 0.0, 0, 0.0, 0.0))
            begin = thread_time()
            rig.cycle.step()
            took[is_flood].append(thread_time() - begin)
            if cycle % 100 == 99:
                while list(link.arrived()):
                    pass
    peer.close()
    quiet, loud = (float(np.percentile(of[1000:], 99)) for of in took)
    return Row("a flood of 100 packets a SYNC: p99 of a cycle, over that without", loud / quiet, "1",
               target="<= 1.2", met=loud <= 1.2 * quiet)  # fmt: skip


def packet_cost() -> Row:
    """Returns the processor time of a SYNC's packet: pack, tag, send, receive, check; the quietest of 20 series."""
    places = ("127.0.0.1", 47811), ("127.0.0.1", 47812)
    links = UdpLink(*places), UdpLink(*reversed(places))
    numbers = iter(range(1, 100))
    sides = [Session(bytes(range(32)), 10**6, 1e15, numbers.__next__, link.send) for link in links]
    took = []
    for cycle in range(11_000):
        begin = thread_time()
        for side, link in zip(sides, links, strict=True):
            side.pass_time(1)
            for data in link.arrived():
                side.take(data, may_begin=True)
            side.say((0, 0, 0, cycle, cycle, cycle, 0.01, 0.1, 0, 0.0, 0.0))
        took.append(0.5 * (thread_time() - begin))
    for link in links:
        link.close()
    series = np.median(np.reshape(took[1000:], (20, -1)), axis=1)
    value, note = 1e6 * float(series.min()), f"the median of the 20 series is {1e6 * float(np.median(series)):.1f} us"
    what = "packet in a SYNC: pack, tag, send, receive, check, p50"
    return Row(what, value, "us", target="<= 12", met=value <= 12.0, note=note)


def main() -> None:
    """Measures and publishes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--networks", type=int, default=24_300, help="of which five in six have a torque")
    parser.add_argument("--pairs", type=int, default=500)
    parser.add_argument("--minutes", type=float, default=60.0, help="for the networks, and for the pairs")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--worlds", type=int, default=2000)
    parser.add_argument("--only", nargs="+", default=[], metavar="KIND", help="of rows; others stay as recorded")
    asked = parser.parse_args()
    kinds: dict[str, Callable[[], list[Row]]] = {
        "networks": lambda: networks(asked.networks, asked.minutes, asked.jobs),
        "packet": lambda: [packet_cost(), flood()],
        "spring": lambda: [felt(0.0), felt(10.0)],
        "model": lambda: [row for cell in CELLS for row in by_model(*cell)],
        "touch": lambda: [*first_touch(40.0, 900.0), *first_touch(100.0, 350.0)],
        "pairs": lambda: over_buses(asked.pairs, asked.minutes, asked.jobs),
        "mutants": mutants,
        "worlds": lambda: rows_of_worlds(asked.worlds, asked.minutes, asked.jobs),
    }
    publish("far_worlds", rows_of_kinds("far_worlds", kinds, parser, asked.only), _PACKAGES)


if __name__ == "__main__":
    main()

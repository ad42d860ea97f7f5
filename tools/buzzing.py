"""Random scenes that buzz, each by one known cause, and calm ones: logs by which `inspect --why` is judged.

    python -m tools.buzzing FOLDER --scenes 400 --calm 200

Each scene is drawn twice: as it is, and with one cause added to it. The simulated plant alone says which of the two
buzzes: a scene is kept if the plant trembles with its cause and rests without it, and drawn again otherwise. The seed
is drawn when the program starts, and written into `scenes.json` with the cause of every log.
"""

import argparse
import copy
import json
import secrets
from collections.abc import Callable, Iterator
from functools import partial
from multiprocessing import Pool
from pathlib import Path
from random import Random
from typing import Any, Final
from warnings import catch_warnings

import numpy as np
import yaml
from scipy.interpolate import CubicSpline

import canhaptic
from canhaptic.errors import CanHapticError

Scene = dict[str, Any]

BUZZES: Final = 0.15
"""Force that the trembling of the moved mass takes, from which a plant buzzes [N, rms]."""
CALM: Final = 0.04
"""Largest such force of a calm plant [N, rms]."""
AGAINST: Final = 4.0
"""Least ratio of that force with and without the cause."""
_WINDOW: Final = 0.25  # [s]
_ARM: Final = 0.06  # of a rotary axis: metres of the handle per radian [m]


# --- scenes -----------------------------------------------------------------------------------------------------------


def base(random: Random) -> Scene:
    """Return a scene with a wall, a device and a hand that are calm by any rule of thumb; linear, in SI."""
    rate, mass = random.choice((500, 800, 1000, 1000, 1250)), random.uniform(0.1, 0.6)
    damping = random.uniform(0.05, 0.6)
    rpdo = random.choice(("synchronous", "synchronous", "event"))
    late = 1.5 if rpdo == "synchronous" else 0.5
    wall_damping = random.uniform(0.02, 0.08) * mass * rate
    stiffness = min(random.uniform(0.1, 0.5) * (damping + wall_damping) * rate / late, 8000.0)
    algorithm = random.choice(("guarded", "unprotected", "internal_dissipation", "passivity_observer"))
    axis = {"name": "handle", "node_id": 1, "eds": "cia402_servo.eds", "unit": "m", "counts_per_unit": 4e6}
    axis |= {"rated_torque": 2.0, "torque_limit": 20.0}
    hand: Scene = {"stiffness": random.uniform(80.0, 300.0), "damping": random.uniform(2.0, 6.0)}
    if random.random() < 0.5:
        amplitude = random.uniform(0.02, 0.05)
        hand["motion"] = {"type": "sinusoid", "amplitude": amplitude, "frequency": random.uniform(0.25, 0.6)}
        hand["motion"]["phase"] = 3.14159
    else:
        hand["push"] = -random.uniform(1.5, 8.0)
    return {
        "duration": 2.5,
        "bus": {"interface": "virtual", "rate": rate, "rpdo": rpdo},
        "axes": [axis],
        "environment": {
            "type": "spring_damper_wall", "stiffness": stiffness, "damping": wall_damping, "position": -0.002,
        },
        "passivity": _protection(algorithm, mass, damping),
        "simulation": {
            "seed": random.randrange(10**6),
            "drive": {"sync_losses_to_fault": 1000},
            "plant": {"mass": mass, "damping": damping},
            "user": hand,
            "effects": [],
        },
    }  # fmt: skip


def _protection(algorithm: str, mass: float, damping: float) -> Scene:
    """Return an algorithm with what it needs to know of a device, on the safe side."""
    if algorithm not in ("guarded", "passivity_observer"):
        return {"algorithm": algorithm}
    known = {
        "device_damping": 0.9 * damping,
        "device_damping_bound": 2.0 * damping,
        "hand_force": 0.0,
        "hand_push": 20.0,
    }
    return {"algorithm": algorithm, "moving_mass": 0.9 * mass, **(known if algorithm == "guarded" else {})}


def _late(scene: Scene) -> float:
    """Return the time between a motion and its torque [s]."""
    return float((1.5 if scene["bus"]["rpdo"] == "synchronous" else 0.5) / scene["bus"]["rate"])


def _without_protection(scene: Scene) -> None:
    scene["passivity"] = {"algorithm": "unprotected"}


def _encoder(random: Random, scene: Scene) -> None:
    force = random.uniform(0.8, 4.0)  # of the damper for one count
    scene["axes"][0]["counts_per_unit"] = scene["environment"]["damping"] * scene["bus"]["rate"] / force


def _damping(random: Random, scene: Scene) -> None:
    _without_protection(scene)
    limit = (0.83 if scene["bus"]["rpdo"] == "synchronous" else 2.0) * scene["simulation"]["plant"]["mass"]
    scene["environment"]["damping"] = random.uniform(1.05, 2.0) * limit * scene["bus"]["rate"]


def _stiffness(random: Random, scene: Scene) -> None:
    _without_protection(scene)
    wall, plant = scene["environment"], scene["simulation"]["plant"]
    wall["damping"] *= random.choice((0.0, 0.3))
    lost = plant["damping"] + wall["damping"] + scene["simulation"]["user"]["damping"]
    wall["stiffness"] = random.uniform(1.3, 8.0) * lost / _late(scene)


def _lateness(random: Random, scene: Scene) -> None:
    scene["passivity"] = {"algorithm": "unprotected"}
    lost = scene["simulation"]["plant"]["damping"] + scene["environment"]["damping"]
    scene["environment"]["stiffness"] = random.uniform(0.5, 0.9) * lost / _late(scene)
    if random.random() < 0.5:
        scene["simulation"]["drive"]["syncs_late"] = random.choice((1, 2, 3, 4))
    else:
        scene["bus"]["loss_limit"] = 1.0
        late = random.uniform(1.0, 3.5) / scene["bus"]["rate"]
        scene["simulation"]["bus"] = {"delay": late, "jitter": random.uniform(0.0, 0.3) * late, "ids": [0x201]}


def _torque_step(random: Random, scene: Scene) -> None:
    step = random.uniform(0.3, 2.0)
    if random.random() < 0.5:
        scene["simulation"]["effects"].append({"type": "torque_quantisation", "quantum": step})
    else:
        scene["axes"][0]["rated_torque"] = round(1000.0 * step)


def _skipped(random: Random, scene: Scene) -> None:
    period = 1.0 / scene["bus"]["rate"]
    scene["bus"] |= {"loss_limit": 1.0, "stop_cycles": 200}
    length = random.uniform(2.5, 9.0) * period
    every = length + random.uniform(4.0, 30.0) * period
    scene["simulation"]["bus"] = {"stall": [{"begin": 0.0, "duration": length, "every": every}]}
    scene["environment"]["stiffness"] *= random.uniform(1.0, 2.5)


def _shaft(random: Random, scene: Scene) -> None:
    _without_protection(scene)
    mass = scene["simulation"]["plant"]["mass"]
    motor = random.uniform(0.3, 0.7) * mass
    resonance = 6.2832 * random.uniform(25.0, 0.25 * scene["bus"]["rate"])
    stiffness = resonance**2 * motor * (mass - motor) / mass
    scene["simulation"]["plant"]["mass"] = motor
    shaft = {"type": "shaft_compliance", "stiffness": stiffness, "damping": random.uniform(0.0, 0.2)}
    scene["simulation"]["effects"].append({**shaft, "load_mass": mass - motor})
    scene["environment"]["stiffness"] *= random.uniform(1.0, 4.0)
    scene["environment"]["damping"] *= random.uniform(0.5, 2.0)


def _current_loop(random: Random, scene: Scene) -> None:
    scene["passivity"] = {"algorithm": "unprotected"}
    scene["environment"]["stiffness"] *= random.uniform(1.0, 2.0)
    lag = random.uniform(1.0, 8.0) / scene["bus"]["rate"]
    scene["simulation"]["effects"].append({"type": "current_loop", "time_constant": lag})


def _stick_slip(random: Random, scene: Scene) -> None:
    static = random.uniform(1.0, 4.0)
    kinetic = random.uniform(0.2, 0.6) * static
    speed = random.uniform(0.005, 0.03)
    effect = {"type": "stribeck_friction", "kinetic": kinetic, "static": static, "stribeck_velocity": speed}
    scene["simulation"]["effects"].append(effect)
    hand = scene["simulation"]["user"]
    hand.pop("push", None)
    hand |= {"stiffness": random.uniform(300.0, 900.0), "damping": random.uniform(0.2, 1.0)}
    amplitude = random.uniform(0.03, 0.06)
    hand["motion"] = {"type": "sinusoid", "amplitude": amplitude, "frequency": random.uniform(0.05, 0.15)}
    if random.random() < 0.5:
        scene["environment"] = {"type": "free_space"}


def _saturation(random: Random, scene: Scene) -> None:
    hand = scene["simulation"]["user"]
    motion = hand.get("motion")
    push = -hand["push"] if motion is None else hand["stiffness"] * motion["amplitude"]
    scene["environment"]["stiffness"] *= random.uniform(1.0, 3.0)
    limit = push * random.uniform(0.2, 0.8)
    if random.random() < 0.7:
        scene["passivity"] = {"algorithm": "internal_dissipation"}
    if random.random() < 0.5:
        scene["axes"][0]["torque_limit"] = limit
    else:
        scene["simulation"]["effects"].append({"type": "torque_saturation", "limit": limit})


def _tremor(random: Random, scene: Scene) -> None:
    hand = scene["simulation"]["user"]
    hand["stiffness"] = max(200.0, hand["stiffness"])
    effect = {"type": "tremor", "amplitude": random.uniform(0.0008, 0.004), "frequency": random.uniform(6.0, 12.0)}
    scene["simulation"]["effects"].append(effect)


def _second_rig(random: Random, scene: Scene) -> None:
    """Join two handles; each is the hand of the other."""
    first = scene["axes"][0]
    scene["axes"] = [{**first, "name": "first"}, {**first, "name": "second", "node_id": 2}]
    simulation, wall = scene["simulation"], scene.pop("environment")
    protection = scene.pop("passivity")
    protection.pop("hand_push", None)
    scene["bus"] |= {"rate": min(800, scene["bus"]["rate"]), "rpdo": "synchronous"}
    if protection["algorithm"] != "guarded":
        mass, damping = simulation["plant"]["mass"], simulation["plant"]["damping"]
        protection = {"algorithm": "guarded", "moving_mass": 0.9 * mass, "device_damping_bound": 2.0 * damping}
        protection |= {"hand_force": 0.0}
    hand = simulation.pop("user")
    far = {**hand, "stiffness": random.uniform(0.3, 1.0) * hand["stiffness"], "rest": 0.02}
    simulation["axes"] = {"first": {"user": hand}, "second": {"user": {**far, "push": 0.0}}}
    far.pop("motion", None)
    simulation["axes"]["second"]["user"].pop("motion", None)
    network = {"type": "coupled_handles", "stiffness": wall["stiffness"], "damping": wall["damping"]}
    scene["groups"] = [{"name": "coupling", "axes": ["first", "second"], "network": network, "passivity": protection}]


def _looped(random: Random, scene: Scene) -> None:
    network = scene["groups"][0]["network"]
    mass = scene["simulation"]["plant"]["mass"]
    scene["groups"][0]["passivity"]["moving_mass"] = random.uniform(2.0, 5.0) * mass
    network["stiffness"] = random.uniform(0.2, 1.0) * mass * scene["bus"]["rate"] ** 2
    network["damping"] *= random.choice((0.0, 0.3))


Cause = Callable[[Random, Scene], None]
CAUSES: Final[dict[str, Cause]] = {
    "encoder": _encoder,
    "damping": _damping,
    "stiffness": _stiffness,
    "lateness": _lateness,
    "torque step": _torque_step,
    "skipped SYNCs": _skipped,
    "shaft": _shaft,
    "current loop": _current_loop,
    "stick-slip": _stick_slip,
    "saturation": _saturation,
    "tremor": _tremor,
    "second rig": _looped,
}
"""What is added to a calm scene, by name."""
_OWN: Final[dict[str, tuple[str, ...]]] = {
    "lateness": ("simulation.drive.syncs_late", "simulation.bus"),
    "skipped SYNCs": ("simulation.bus",),
    "saturation": ("axes.0.torque_limit", "simulation.effects"),
    "torque step": ("simulation.effects", "axes.0.rated_torque"),
    "shaft": ("simulation.effects", "simulation.plant.mass", "environment"),
    **dict.fromkeys(("current loop", "stick-slip", "tremor"), ("simulation.effects",)),
    "encoder": ("axes.0.counts_per_unit",),
    "damping": ("environment.damping",),
    "stiffness": ("environment.stiffness", "environment.damping"),
    "second rig": ("groups.0.network", "groups.0.passivity"),
}
"""Places that make a cause: the scene without it has there what it had before."""


def _moved(scene: Scene, path: str, source: Scene) -> None:
    """Give a place of a scene the value that it has in another scene, or remove it as there."""
    *owners, last = path.split(".")
    for name in owners:
        scene, source = (of[int(name)] if isinstance(of, list) else of[name] for of in (scene, source))
    if last in source:
        scene[last] = copy.deepcopy(source[last])
    else:
        scene.pop(last, None)


def pair(kind: str, random: Random) -> tuple[Scene, Scene]:
    """Return a scene without and with one cause."""
    before = base(random)
    if kind == "second rig":
        _second_rig(random, before)
    after = copy.deepcopy(before)
    CAUSES[kind](random, after)
    without = copy.deepcopy(after)
    for path in _OWN[kind]:
        _moved(without, path, before)
    is_rotary = kind != "second rig" and random.random() < 0.2
    return (rotary(without), rotary(after)) if is_rotary else (without, after)


_LENGTHS: Final = ("amplitude", "rest", "position", "stribeck_velocity")
_FORCES: Final = ("push", "rated_torque", "torque_limit", "kinetic", "static", "limit", "quantum")
_FORCES_SQUARED: Final = ("mass", "load_mass", "moving_mass")
_DAMPED: Final = ("stiffness", "damping", "device_damping", "device_damping_bound", "hand_force", "hand_push")


def rotary(scene: Scene) -> Scene:
    """Return the same scene of a rotary axis, whose handle is on an arm."""

    def turned(value: Any, key: str = "") -> Any:
        if isinstance(value, dict):
            return {name: turned(of, name) for name, of in value.items()}
        if isinstance(value, list):
            return [turned(of) for of in value]
        if key in _LENGTHS:
            return value / _ARM
        if key in (*_FORCES, "hand_force", "hand_push"):
            return round(value * _ARM, 3) if key == "rated_torque" else value * _ARM
        if key in (*_FORCES_SQUARED, *_DAMPED):
            return value * _ARM**2
        return value * _ARM if key == "counts_per_unit" else "rad" if key == "unit" else value

    turned_scene: Scene = turned(scene)
    return turned_scene


# --- what the plant says ----------------------------------------------------------------------------------------------


def trembling(log: canhaptic.EnergyLog, scene: Scene) -> float:
    """Return the force that the trembling of the true position takes: median of windows in contact [N, rms].

    From each window of 0.25 s a cubic is subtracted, which is the hand's own motion. Of two handles the worse counts.
    """
    simulation = scene["simulation"]
    mass = simulation["plant"]["mass"]
    wall = scene.get("environment", {}).get("position", np.inf)
    arm = _ARM if scene["axes"][0]["unit"] == "rad" else 1.0
    worst = 0.0
    for port in log.truth:
        time = log.time  # of skipped SYNCs there is no row
        position = CubicSpline(time, log.truth[port]["position"])(np.arange(0.0, time[-1], log.sample_time))
        size = round(_WINDOW / log.sample_time)
        found = []
        for start in range(size, len(position) - size, size // 2):
            part = position[start : start + size]
            if np.mean(part < wall) >= 0.1:
                found.append(_residue(part, log.sample_time))
        if not found:
            return float("nan")
        worst = max(worst, float(np.median(found)) * mass / arm)
    return worst


def _residue(position: Any, period: float) -> float:
    """Return the rms acceleration of a window, its cubic part subtracted [m/s^2]."""
    place = np.linspace(-1.0, 1.0, len(position))
    rest = position - np.polyval(np.polyfit(place, position, 3), place)
    return float(np.sqrt(np.mean(np.diff(rest, 2) ** 2))) / period**2


def simulated(scene: Scene, path: Path) -> float:
    """Run a scene, write its file and its log, and return the trembling of its plant; NaN for a run that fails."""
    path.with_suffix(".yaml").write_text(yaml.safe_dump(scene, sort_keys=False), encoding="utf-8")
    try:
        with catch_warnings(action="ignore"):
            result = canhaptic.simulate(path.with_suffix(".yaml"), progress=False, check=False)
            if result.status != "completed":
                print(f"{path.name}: {result.status}")
                return float("nan")
            result.save(path.with_suffix(".h5"), overwrite=True)
            with result.log() as log:
                return trembling(log, scene)
    except CanHapticError as error:
        print(f"{path.name}: {error}")
        return float("nan")


def kept(job: tuple[str, int, bool], folder: Path, tries: int = 12) -> dict[str, Any]:
    """Draw scenes of one kind until one buzzes with its cause and not without, or, of the calm, until one is calm."""
    kind, seed, is_calm = job
    random = Random(seed)
    name = folder / f"{'calm' if is_calm else 'buzz'}_{seed:08x}"
    for drawn in range(1, tries + 1):
        without, scene = pair(kind, random)
        if is_calm:
            chosen = scene if random.random() < 0.3 else without
            if (now := simulated(chosen, name)) <= CALM:
                return {"file": name.name, "cause": None, "kind": kind, "trembling": now, "drawn": drawn}
            continue
        now = simulated(scene, name)
        if not now >= BUZZES:
            continue
        rest = simulated(without, name.with_name(f"{name.name}_without"))
        for suffix in (".h5", ".yaml"):
            name.with_name(f"{name.name}_without").with_suffix(suffix).unlink(missing_ok=True)
        if rest * AGAINST <= now:
            found = {"file": name.name, "cause": kind, "trembling": now, "without": rest, "drawn": drawn}
            return {**found, "seed": seed}
    return {"file": None, "cause": kind, "drawn": tries}


def jobs_of(scenes: int, calm: int, seed: int) -> Iterator[tuple[str, int, bool]]:
    """Yield (kind, seed, whether calm) of each scene; every kind comes as often as the others."""
    random, kinds = Random(seed), list(CAUSES)
    for number in range(scenes + calm):
        yield kinds[number % len(kinds)], random.randrange(1 << 32), number >= scenes


def main() -> None:
    """Draw, run and keep the scenes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scenes", type=int, default=400)
    parser.add_argument("--calm", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=None, help="to repeat a set; drawn otherwise")
    parser.add_argument("--kinds", nargs="*", default=None)
    arguments = parser.parse_args()
    seed = secrets.randbits(32) if arguments.seed is None else arguments.seed
    arguments.folder.mkdir(parents=True, exist_ok=True)
    jobs = list(jobs_of(arguments.scenes, arguments.calm, seed))
    if arguments.kinds:
        jobs = [(arguments.kinds[n % len(arguments.kinds)], *job[1:]) for n, job in enumerate(jobs)]
    with Pool(arguments.jobs) as pool:
        found = list(pool.imap_unordered(partial(kept, folder=arguments.folder), jobs))
    (arguments.folder / "scenes.json").write_text(json.dumps({"seed": seed, "scenes": found}, indent=1))
    for kind in CAUSES:
        of = [row for row in found if row["cause"] == kind]
        print(f"{kind}: {sum(row['file'] is not None for row in of)} of {len(of)}, drawn {sum(r['drawn'] for r in of)}")
    print(f"calm: {sum(row['cause'] is None and row['file'] is not None for row in found)}; seed {seed}")


if __name__ == "__main__":
    main()

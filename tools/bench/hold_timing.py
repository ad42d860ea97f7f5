"""What does real timing cost? Stiffness held by `guarded` where holds are uneven and torques come late, against exact.

The device, the push and the judgement of `feel`: 0.25 kg, 5 N that rise in 0.3 s. Declared of every hold are 2 % of
jitter, a current loop of 100 us, which the device has too, the window in which an event RPDO acts on a bus of 1 Mbit/s
(one axis, frames of the shipped dictionary), and all of them together. Next to what is held is what the certificate
holds.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

from canhaptic.control.certificates.scalar_bounds import displacement_response, hold_timing, renderable_by_hand_force
from canhaptic.files import shipped
from canhaptic.lab.studies.design.contact_quality import Bench, Leaning, largest_held, settling_time
from canhaptic.scene.load import load_scene
from canhaptic.sim.plant.effects.current_loop import CurrentLoop
from canhaptic.sim.plant.plant import PlantParameters
from tools.bench.feel import BEYOND, HAND_FORCES, MASS, PUSH, SOFTEST, STIFF_WALL
from tools.bench.report import Row, publish
from tools.bench.standard_cases import USER_S, standard_case

LOOPS: Final = {
    "1 kHz, one late, b 0.5": (1000.0, 1, 0.5),
    "1 kHz, event, b 0.5": (1000.0, 0, 0.5),
    "100 Hz, one late, b 0.1": (100.0, 1, 0.1),
}
JITTER: Final = 0.02
LAG: Final = 1e-4  # [s]
_SOFTEST: Final = 0.05
"""Wall tried first, over what the certificate holds."""


def event_window() -> float:
    """Returns the time after a SYNC in which an event RPDO acts at the latest, on a bus of 1 Mbit/s [s]."""
    scene = load_scene(shipped("configs") / "demo.yaml", ["bus.rpdo=event", "bus.bitrate=1 Mbit/s"])
    window = scene.axes[0].loop.torque_window
    assert window is not None
    return window


def timings(delay: int) -> dict[str, dict[str, float]]:
    """Returns what is declared, by name; an event RPDO alone comes within a window."""
    known: dict[str, dict[str, float]] = {"jitter 2 %": {"sync_jitter": JITTER}, "lag 100 us": {"current_lag": LAG}}
    if delay == 0:
        known["event window"] = {"torque_window": event_window()}
    together = {key: value for declared in known.values() for key, value in declared.items()}
    return {"exact": {}, **known, "all": together}


def held_at(loop: str, hand_force: float, declared: dict[str, float]) -> tuple[float, float]:
    """Returns the largest stiffness held and what the certificate holds [N/m].

    Args:
        loop: A name of `LOOPS`.
        hand_force: Declared [N].
        declared: Of the holds.
    """
    rate, delay, damping = LOOPS[loop]
    plant = PlantParameters(mass=MASS, damping=damping)
    case = standard_case(STIFF_WALL, "guarded", rate, USER_S, delay=delay, plant=plant, hand_force=hand_force)
    case = replace(case, loop=case.loop.model_copy(update=declared))
    lag = declared.get("current_lag")
    effects: Any = () if lag is None else (CurrentLoop(time_constant=lag),)
    leaning = Leaning(push=PUSH, duration=settling_time(MASS, damping), per_decade=6, fine=0.01)
    jitter, window = declared.get("sync_jitter", 0.0), declared.get("torque_window", 0.0)
    timing = hold_timing(1.0 / rate, jitter, window, lag or 0.0)
    ideal = displacement_response(1.0 / rate, MASS, 0.0, 0.0, damping)
    limit = displacement_response(1.0 / rate, MASS, hand_force, 0.0, damping, timing=timing)
    certified = renderable_by_hand_force(limit, delay, PUSH)
    stiffest = BEYOND * renderable_by_hand_force(ideal, delay, PUSH)
    bench, softest = Bench(case, plant, effects), max(SOFTEST, _SOFTEST * certified)
    found = largest_held(bench, leaning, softest, stiffest)
    if not found.stiffness:
        found = largest_held(bench, leaning, SOFTEST, softest)
    return found.stiffness, certified


def rows() -> Iterator[Row]:
    """What is held in every loop at every hand force, and its share of what is held with exact holds."""
    for loop, (_, delay, _) in LOOPS.items():
        for hand_force in HAND_FORCES:
            exact = 0.0
            for name, declared in timings(delay).items():
                found, limit = held_at(loop, hand_force, declared)
                exact = exact or found
                where = f"{loop}, F_h {hand_force:g} N"
                yield Row(f"held, {where}: {name}", found, "N/m", "certificate", limit, found / limit)
                if declared:
                    yield Row(f"of exact, {where}: {name}", found / exact if exact else 0.0, "1")


def main() -> None:
    """Measures and publishes the table."""
    publish(
        "hold_timing", [Row("event window of 1 Mbit/s", 1e6 * event_window(), "us"), *rows()], ["canhaptic", "numpy"]
    )


if __name__ == "__main__":
    main()

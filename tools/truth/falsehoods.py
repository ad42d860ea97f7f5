"""Scenes and displays with one false declaration each, and the same scene by every way of running it.

A declaration is false of the hold in which a torque acts, of the lag of a current loop, of the window of late torques
(below the truth), or of the holds of a display's commands, which also lose samples. Half of the scenes render detents
at 100 or 250 Hz, where a torque in a neighbouring hold changes the sum most. Frames show such a thing where a torque
that is read back, the hold's own test or the motion says otherwise.
"""

import copy
from dataclasses import replace
from typing import Any, Final

from canhaptic.errors import ControlError
from tools.chance import Chance
from tools.displays.direct import run as run_display
from tools.displays.judge import false_claims
from tools.displays.random_display import random_display, with_true_bounds
from tools.truth.judge import Outcome, judged
from tools.truth.scenes import TruthScene, random_scene
from tools.truth.ways import differences

SHOWN: Final = {
    "false:hold": "by the run's own test of it",
    "false:commands": "by force and motion in the run",
    "false:moving_mass": "by commission",
    "false:current_lag": "by commission",
    "false:torque_window": "by commission",
}
"""False declarations that frames can show, and when; none shows a wrong `counts_per_unit`."""
_DISPLAYS: Final = 0.2
_DETENTS: Final = 0.5
_RUN_ALIKE: Final = 0.1
_CYCLES: Final = 400


def outcome_of_falsehood(seed: int) -> Outcome:
    """Returns what a scene or a display with one false declaration came to, by all ways of running it for some."""
    chance = Chance(seed, 53)
    if chance.drawn(_DISPLAYS):
        return of_display(seed, chance)
    scene, outcome = judged(with_falsehood(seed, chance))
    if chance.drawn(_RUN_ALIKE):
        outcome = replace(outcome, false_claims=(*outcome.false_claims, *differences(scene, outcome)))
    return outcome


def falsified(seed: int) -> TruthScene:
    """Returns the scene with one false declaration that `outcome_of_falsehood` runs for a seed, if it runs a scene."""
    chance = Chance(seed, 53)
    chance.drawn(_DISPLAYS)
    return with_falsehood(seed, chance)


def with_falsehood(seed: int, chance: Chance) -> TruthScene:
    """Returns the first scene of one guarded axis from a seed on, with one false declaration of its timing."""
    place = 1000 * seed
    while not is_fit(scene := random_scene(place, sums=0.0)):
        place += 1
    values, tags, rates = copy.deepcopy(scene.values), set(scene.tags), (100, 250)
    if chance.drawn(_DETENTS):
        tags -= {tag for tag in tags if tag.startswith(("environment:", "rate:"))}
        values["bus"]["rate"] = rate = chance.one_of(rates)
        peak, pitch = chance.decades(0.6, 5.0), chance.decades(3e-3, 2e-2)
        values["environment"] = {"type": "detents", "peak": peak, "pitch": pitch}
        values["passivity"].setdefault("hand_push", chance.decades(5.0, 40.0))
        scene, tags = replace(scene, outward=(0,)), tags | {"environment:detents", f"rate:{rate}"}
    kind = chance.one_of(("hold", "current_lag", "torque_window"))
    _declare(chance, values, kind)
    return replace(scene, seed=seed, values=values, tags=frozenset(tags | {f"false:{kind}"}))


def is_fit(scene: TruthScene) -> bool:
    """Whether a scene has one axis, `guarded`, and a timing that is declared truly and not yet drawn."""
    plain = not any(tag.startswith(("false:", "timing:", "hold:", "drive:acts")) for tag in scene.tags)
    return plain and scene.promises and "groups" not in scene.values and scene.passivity.get("hand_force") is not None


def _declare(chance: Chance, values: dict[str, Any], kind: str) -> None:
    """Makes the drive of a scene act otherwise than declared."""
    simulation, bus, passivity, part = (
        values["simulation"],
        values["bus"],
        values["passivity"],
        chance.decades(0.05, 0.6),
    )
    if kind == "hold":
        is_synchronous = bus["rpdo"] == "synchronous"
        simulation["drive"].update(
            {"acts_at_once": True} if chance.drawn(0.5) and is_synchronous else {"syncs_late": 1}
        )
    elif kind == "current_lag":
        others = [effect for effect in simulation["effects"] if effect["type"] not in ("current_loop", "voltage_limit")]
        lag = chance.decades(2e-4, 2e-3)
        simulation["effects"] = [*others, {"type": "current_loop", "time_constant": lag}]
        passivity["current_lag"] = [0.1 * part * lag, part * lag]
    else:
        late = chance.decades(0.05, 0.3) / bus["rate"]
        bus["rpdo"], simulation["bus"] = "event", {"delay": late, "direction": "to_drive"}
        passivity["torque_window"] = [0.1 * part * late, part * late]


def of_display(seed: int, chance: Chance) -> Outcome:
    """Returns what a display came to that loses samples, and whose commands act later than declared."""
    found = with_true_bounds(random_display(seed, "guarded"), _CYCLES)
    tags = ("admittance", "algorithm:guarded", "false:commands")
    energies: Any = dict.fromkeys(("resolution", "error", "least", "peak", "asked"), 0.0)
    empty = Outcome(seed, tags, "refused", "in doubt", "", (), **energies, declared=False, false_claims=())
    if found is None:
        return empty
    display = replace(found[0], late=int(chance.generator.integers(1, 6)), samples_lost=0.024)
    try:
        run = run_display(display, _CYCLES)
    except ControlError as error:
        return replace(empty, status="stopped", text=str(error))
    return replace(
        empty, status="completed", verdict="yes" if run.is_passive else "in doubt", least=run.least, peak=run.force,
        asked=run.force, resolution=run.doubt, error=max(run.overclaimed, run.underclaimed),
        certificates=() if run.uncertified else ("velocity_loop",), false_claims=tuple(false_claims(display, run)),
    )  # fmt: skip

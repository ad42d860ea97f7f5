"""Random twins of drives, each through the test of commissioning that finds the hold in which its torque acts.

A twin acts at once, at its SYNC, one or two SYNCs late; reports its torque before or after its update, or none; has a
lag of 0 to 1 ms, a mass, a torque, an encoder, dry or falling friction, a shaft or none. Each runs the reversals of
`canhaptic commission` on the virtual bus. Wrong is a hold, or a time of its report, that is not the true one; unclear,
where nothing is said.
"""

from pathlib import Path
from typing import Any, Final, NamedTuple

from canhaptic.commission.mass_and_friction import time_the_torque
from canhaptic.commission.session import CommissioningLimits, Session, StepVerdict, Unattended
from canhaptic.scene.load import scene_from_mapping
from tools.chance import Chance

_SOURCE: Final = str(Path(__file__).resolve().parents[1] / "configs" / "which_hold.yaml")


class Twin(NamedTuple):
    """One drawn drive, and what commissioning said of it."""

    seed: int
    true_hold: int
    hold: int | None
    wrong_read_back: bool
    named: str


def _drawn(seed: int) -> tuple[dict[str, Any], int, float, float]:
    """Returns a scene, the true hold, torque and mass."""
    chance = Chance(seed, 29)
    decades, generator = chance.decades, chance.generator
    hold, rate = chance.one_of((-1, 0, 1, 2)), chance.one_of((500, 1000, 1000, 1000))
    mass, torque = decades(0.05, 0.6), decades(0.5, 5.0)
    drive = {"acts_at_once": hold < 0, "syncs_late": max(0, hold), "objects": {"0x6502": 0x200}}
    if chance.drawn(0.4):
        drive["torque_read_back"] = "after_update"
    effects: list[dict[str, Any]] = []
    if chance.drawn(0.8):
        effects.append({"type": "current_loop", "time_constant": max(1e-5, float(generator.uniform(0.0, 1e-3)))})
    friction, kinetic = chance.one_of(("", "coulomb_friction", "stribeck_friction")), decades(0.02, 0.3) * torque
    if friction:
        effects.append({"type": friction, "kinetic": kinetic, "static": 1.3 * kinetic})
        if friction == "stribeck_friction":
            effects[-1]["stribeck_velocity"] = decades(2e-2, 1e-1)
    load = 0.0
    if chance.drawn(0.25):
        load = decades(0.03, 0.3)
        shaft = {"stiffness": decades(2e3, 1e5), "damping": decades(0.5, 10.0), "load_mass": load}
        effects.append({"type": "shaft_compliance", **shaft})
    axis = {
        "name": "handle", "node_id": 1, "eds": "cia402_servo.eds", "unit": "m",
        "counts_per_unit": float(f"{1.0 / decades(3e-7, 1e-5):.4g}"), "rated_torque": 50.0, "torque_limit": 50.0,
        "read_back": "none" if chance.drawn(0.2) else "auto",
    }  # fmt: skip
    scene = {
        "duration": 1.0, "bus": {"rate": rate}, "axes": [axis],
        "environment": {"type": "spring_damper_wall", "stiffness": 1000.0, "position": -1.0},
        "passivity": {"algorithm": "unprotected", "current_lag": 2e-3},
        "simulation": {"drive": drive, "plant": {"mass": mass, "damping": decades(0.02, 1.0)}, "effects": effects},
    }  # fmt: skip
    return scene, hold, torque, mass + load


def outcome_of(seed: int) -> Twin:
    """Returns what commissioning says of the twin of a seed."""
    values, hold, torque, mass = _drawn(seed)
    session = Session(
        scene_from_mapping(values, _SOURCE), Unattended(lambda _: None), CommissioningLimits(), lambda: False
    )
    kinetic = sum(effect.get("kinetic", 0.0) for effect in values["simulation"]["effects"])
    with session.rig_of(with_hand=False):
        time_the_torque(session, 0, torque, mass, {"device_friction_bound": 2.0 * kinetic})
    rows = {found.item: found for found in session.report.findings}
    motion, booked = rows.get("command to motion"), rows.get("read-back to motion")
    found = None if motion is None or motion.verdict is StepVerdict.UNKNOWN else motion.found
    is_after = values["simulation"]["drive"].get("torque_read_back") == "after_update" and hold >= 0
    said = None if booked is None or booked.verdict is StepVerdict.UNKNOWN else booked.verdict is not StepVerdict.AGREES
    named = " ".join([str(values["bus"]["rate"]), *(effect["type"] for effect in values["simulation"]["effects"])])
    return Twin(seed, hold, _hold_in(found), said not in (None, is_after), named)


def _hold_in(found: str | None) -> int | None:
    """Returns the hold that a row names, counted from the declared one."""
    return None if found is None else int(found.partition(" ")[0]) - 1

"""What random scenes name in addition: environments, algorithms, networks and declarations of every kind.

Drawn from a generator of its own, so that a seed keeps what `scenes` draws for it. LuGre friction declares no
`device_friction`: its bristles give back what a small motion put into them, and no path dissipates for certain.
"""

from typing import Any, Final

from tools.chance import Chance

_DRY: Final = ("coulomb_friction", "stribeck_friction")
_ALGORITHMS: Final = (
    *("adaptive_reference", "bounded_observer", "energy_tank", "force_augmentation", "force_gradient"),
    *("ultimate_passivity", "windowed_observer"),
)
"""Without a promise, as those that take their place."""


def add_further(seed: int, values: dict[str, Any], tags: set[str], outward: tuple[int, ...]) -> tuple[int, ...]:
    """Adds to a scene what a generator of its own draws; returns the direction out of the environment of each axis.

    Args:
        seed: Of the scene.
        values: Changed.
        tags: Changed.
        outward: Of the scene without it.
    """
    chance = Chance(seed, 23)
    if "algorithm:guarded" in tags:
        section = values["groups"][0]["passivity"] if "groups" in values else values["passivity"]
        for key, found in _declared(chance, values, tags).items():
            section[key] = found
            tags.add(f"declares:{key}")
    elif "groups" not in values and chance.drawn(0.4):
        _name(tags, "algorithm", chance.one_of(_ALGORITHMS), values["passivity"])
    if "groups" not in values and chance.drawn(0.05):
        outward = (0,)
        _name(tags, "environment", "detents")
        peak, pitch = chance.decades(0.6, 10.0), chance.decades(3e-3, 2e-2)
        values["environment"] = {"type": "detents", "peak": peak, "pitch": pitch, "damping": chance.decades(0.1, 10.0)}
    if "effect:shaft_compliance" in tags and "effect:backlash" not in tags and chance.drawn(0.15):
        values["simulation"]["effects"].append({"type": "backlash", "gap": chance.decades(1e-5, 5e-4)})
        tags.add("effect:backlash")
    if "group:xy_box" in tags and chance.drawn(0.4):
        _other_network(chance, values["groups"][0], tags)
    if "drive:read_actual" in tags and chance.drawn(0.3):
        ripple, pitch = chance.decades(1e-3, 0.02), chance.decades(2e-3, 2e-2)
        values["simulation"]["drive"].update(torque_ripple=ripple, torque_ripple_pitch=pitch)
        tags.add("drive:torque_ripple")
    _act_in_another_hold(chance, values, tags)
    if "algorithm:guarded" in tags and "groups" not in values:
        _near_the_bounds(chance, values, tags)
        if chance.drawn(0.1) and len(values["axes"]) == 1:
            axis = values["axes"][0]
            axis["hold_dither"] = max(chance.decades(0.02, 0.5), 0.005 * axis["rated_torque"])
            tags.add("declares:hold_dither")
        _let_friction_brake(Chance(seed, 43), values, tags)
    return outward


def _let_friction_brake(chance: Chance, values: dict[str, Any], tags: set[str]) -> None:
    """Declares in half of the scenes with dry friction that it brakes; bristles by their own stiffness."""
    passivity, is_drawn, ratio = values["passivity"], chance.drawn(0.5), chance.decades(1.3, 1000.0)
    effects = {effect["type"]: effect for effect in values["simulation"]["effects"]}
    if not is_drawn or "moving_mass" not in passivity:
        return
    if (lugre := effects.get("lugre_friction")) is not None:
        passivity["device_friction_bound"] = float(f"{1.1 * lugre['static']:.4g}")
        stiffness = 0.9 * lugre["bristle_stiffness"]
    elif "device_friction_bound" in passivity:
        stiffness = ratio * passivity["moving_mass"] * values["bus"]["rate"] ** 2
    else:
        return
    passivity.update(device_cogging_bound=0.0, presliding_stiffness=float(f"{stiffness:.4g}"))
    tags.add("declares:presliding_stiffness")


def _near_the_bounds(chance: Chance, values: dict[str, Any], tags: set[str]) -> None:
    """Takes encoders too coarse for the wall, against the friction declared, and an allowance by the law of `new`."""
    passivity, wall, axis = values["passivity"], values["environment"], values["axes"][0]
    coarse, allowed, count = chance.drawn(0.25), chance.drawn(0.15), chance.decades(3e-6, 1e-4)
    ratio, share = chance.decades(0.5, 8.0), chance.decades(0.1, 3.0)
    if coarse and passivity.get("device_friction") and "stiffness" in wall:
        axis["counts_per_unit"] = 1.0 / count
        wall["stiffness"] = float(f"{min(1e5, ratio * passivity['device_friction'] / count):.4g}")
        tags.add("encoder:coarse")
    if allowed and passivity.get("hand_force") is not None and "moving_mass" in passivity:
        pull = passivity["hand_force"] + passivity.get("device_friction_bound", 0.0)
        late = 3.0 if values["bus"]["rpdo"] == "synchronous" else 1.0
        h = late / values["bus"]["rate"] ** 2 / passivity["moving_mass"]
        passivity["energy_allowance"] = float(f"{min(1e-3, share * h * pull**2 / 4.0):.4g}")
        tags.add("declares:allowance_by_law")


def _act_in_another_hold(chance: Chance, values: dict[str, Any], tags: set[str]) -> None:
    """Takes drives that act at once or a SYNC late: declared, or in a few scenes not."""
    is_declared = chance.drawn(0.8)
    if not chance.drawn(0.08):
        return
    if not is_declared:
        values["simulation"]["drive"].update(chance.one_of(({"acts_at_once": True}, {"syncs_late": 1})))
        tags.add("false:hold")
        return
    quirk = "acts_a_sync_late" if values["bus"]["rpdo"] == "synchronous" else "acts_at_once"
    for axis in values["axes"]:
        axis["quirks"] = [*axis.get("quirks", ()), quirk]
    tags.add(f"drive:{quirk}")


def _name(tags: set[str], dimension: str, name: str, section: dict[str, Any] | None = None) -> None:
    """Takes a name in the place of another one of its kind."""
    tags -= {tag for tag in tags if tag.startswith(f"{dimension}:")}
    tags.add(f"{dimension}:{name}")
    if section is not None:
        section[dimension] = name


def _declared(chance: Chance, values: dict[str, Any], tags: set[str]) -> dict[str, Any]:
    """Returns what `guarded` declares in addition; what is said of hand and losses is raised to what they were."""
    found: dict[str, Any] = {}
    drawn, decades = chance.drawn, chance.decades
    for key, low, high in (*(("energy_allowance", 1e-5, 1e-2), ("hand_speed", 0.05, 1.0), ("alpha", 1.0, 1e4)),):
        if drawn(0.08):
            found[key] = decades(low, high)
    _ = drawn(0.08) and decades(0.05, 1.0)  # of a key that is gone: every seed keeps its scene
    if "alpha" in found:
        found["alpha"] = f"{found['alpha']} s/{values['axes'][0]['unit']}^2"
    if "groups" in values:
        return found
    dry = next((effect for effect in values["simulation"]["effects"] if effect["type"] in _DRY), None)
    if dry is not None and drawn(0.6):
        found["device_friction"] = float(f"{dry['kinetic'] * min(1.0, decades(0.4, 1.2)):.4g}")
        found["device_friction_bound"] = float(f"{1.1 * dry['static']:.4g}")
    if drawn(0.25):
        found["earned_energy"] = decades(1e-4, 5e-2)
        if drawn(0.6):
            found["drag"] = decades(0.05, 0.5)
    if ("device_friction" in found or "declares:device_damping" in tags) and drawn(0.15):
        found["hand_force"] = None
    if drawn(0.4 if "timing:drop" in tags else 0.04) and "drive:after_update" not in tags:
        found["max_consecutive_losses"] = 1 if drawn(0.6) else 2
    return found


def _other_network(chance: Chance, group: dict[str, Any], tags: set[str]) -> None:
    """Takes another network than the box of a stage."""
    common = {key: group["network"][key] for key in ("stiffness", "damping")}
    networks: dict[str, dict[str, Any]] = {
        "sphere": {"centre": [0.0, -0.02], "radius": 0.02},
        "plane": {"normal": [1.0, 0.7], "offset": -0.004},
        "moving_wall": {
            "normal": [1.0, 0.3], "offset": -0.01, "amplitude": chance.decades(1e-3, 1e-2),
            "frequency": chance.decades(0.3, 3.0),
        },
    }  # fmt: skip
    name = chance.one_of(tuple(networks))
    group["network"] = {"type": name, **networks[name], **common}
    tags -= {"group:xy_box"}
    tags.add(f"group:stage_{name}")

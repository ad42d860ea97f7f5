"""Sums in random scenes: the environment of an axis, or the box of a stage, with further parts at the same handle.

Drawn from a generator of its own, so that every seed keeps what the others draw for it.
"""

from typing import Any, Final

from canhaptic.control.environments import ENVIRONMENTS, outside_of
from canhaptic.control.environments.sum_of_parts import added
from canhaptic.errors import ParameterError
from canhaptic.registry import load
from tools.chance import Chance

SHARE: Final = 0.06
"""Share of all scenes."""
_STRAINED: Final = ("viscoelastic_medium", "coulomb_surface")
_TRIES: Final = 8


def add_sum(
    seed: int, values: dict[str, Any], tags: set[str], outward: tuple[int, ...], share: float = SHARE
) -> tuple[int, ...]:
    """Makes the environment of some scenes a sum; returns the direction out of it, of each axis.

    Args:
        seed: Of the scene.
        values: Changed.
        tags: Changed.
        outward: Of the scene without it.
        share: Of the scenes.
    """
    chance = Chance(seed, 53)
    if not chance.drawn(share):
        return outward
    if "groups" in values:
        network = values["groups"][0]["network"]
        if network["type"] == "box":
            values["groups"][0]["network"] = [network, _path(chance)]
            tags.add("sum:networks")
        return outward
    for _ in range(_TRIES):
        parts = [values["environment"], *_further_parts(chance, values["environment"]["type"])]
        try:
            environment = added([(part["type"], _made(part)) for part in parts])
        except ParameterError:  # no place at which all of them rest
            continue
        values["environment"] = parts
        tags |= {f"environment:{part['type']}" for part in parts} | {f"sum:{len(parts)}"}
        return (int(outside_of(environment)),)
    return outward


def _made(part: dict[str, Any]) -> Any:
    model = load(ENVIRONMENTS, part["type"], "environment")
    return model(**{key: value for key, value in part.items() if key != "type"})


def _further_parts(chance: Chance, first: str) -> list[dict[str, Any]]:
    """Returns one to three parts; a strain adds to a medium alone."""
    medium = {"type": "viscous_medium", "damping": chance.decades(0.3, 20.0)}
    if first in _STRAINED:
        return [medium]
    position = float(f"{chance.generator.uniform(-0.006, 0.004):.4g}")
    far = position + chance.decades(1e-3, 2e-2)
    stiffness, damping = chance.decades(100.0, 10_000.0), chance.one_of((0.0, chance.decades(0.5, 10.0)))
    solid = {"stiffness": stiffness, "damping": damping}
    kinds: list[dict[str, Any]] = [
        medium,
        {"type": "spring_damper_wall", "position": position, **solid},
        {"type": "spring_damper_wall", "position": far, "side": "above", **solid},
        {"type": "hardening_wall", "position": position, "hardening": 1e4 * stiffness, **solid},
        {"type": "damper_wall", "position": position, "damping": chance.decades(1.0, 50.0)},
        {"type": "two_sided_wall", "lower": position, "upper": far, **solid},
    ]
    if first != "detents":
        notches = {"peak": chance.decades(0.6, 6.0), "pitch": chance.decades(1e-3, 1e-2), "position": position}
        kinds += [{"type": "detents", "damping": damping, **notches}] * 3
    count = 1 + int(chance.generator.integers(3))
    places = chance.generator.permutation(len(kinds))[:count]
    chosen = [kinds[place] for place in places]
    return [part for n, part in enumerate(chosen) if part["type"] != "detents" or part not in chosen[:n]]


def _path(chance: Chance) -> dict[str, Any]:
    corners = [[float(f"{v:.4g}") for v in row] for row in chance.generator.uniform(-0.015, 0.015, (3, 2))]
    width = chance.one_of((0.0, chance.decades(5e-4, 3e-3)))
    found = {"points": corners, "stiffness": chance.decades(100.0, 3000.0), "damping": chance.decades(0.1, 10.0)}
    return {"type": "guided_path", "width": width, **found}

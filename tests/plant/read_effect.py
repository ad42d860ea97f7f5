"""An effect from the mapping that a scene has of it."""

from collections.abc import Mapping
from typing import Any, cast

from canhaptic.axis_units import Motion
from canhaptic.registry import load
from canhaptic.sim.plant.effects import EFFECTS, Effect


def read_effect(values: Mapping[str, Any], motion: Motion | None = None) -> Effect:
    return cast(Effect, load(EFFECTS, values["type"], "effect").validated(values, motion))

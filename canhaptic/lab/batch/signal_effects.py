"""Effects of a plant that change a number and not a motion: the encoder reading, and the torque that acts."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import expm1, inf
from typing import Any, Final

from canhaptic.lab.batch.closed_loop import Signals, Winding
from canhaptic.scene.components import ComponentSpec

_NOISE: Final = "encoder_noise"
_TORQUE: Final = ("torque_saturation", "thermal_derating", "torque_quantisation")
SIGNAL_EFFECTS: Final = (_NOISE, "encoder_quantisation", *_TORQUE)
"""Their names in a scene."""


@dataclass(frozen=True, slots=True)
class SignalEffects:
    """Signal effects of one plant, in the order in which they act."""

    effects: tuple[ComponentSpec, ...] = ()

    @classmethod
    def of(cls, effects: Sequence[ComponentSpec]) -> "SignalEffects":
        """Signal effects among the effects of a plant."""
        return cls(tuple(effect for effect in effects if effect.name in SIGNAL_EFFECTS))

    def at(self, sample_time: float, seed: int) -> Signals:
        """The effects as numbers.

        Args:
            sample_time: Sample time [s].
            seed: Seed of everything random.
        """
        found: dict[str, Any] = {effect.name: effect.parameters for effect in self.effects}
        order = [effect.name for effect in self.effects if effect.name in _TORQUE]
        noise, encoder = found.get(_NOISE), found.get("encoder_quantisation")
        saturation, rounding = found.get("torque_saturation"), found.get("torque_quantisation")
        warms = found.get("thermal_derating")
        last = saturation is not None and warms is not None and order.index("thermal_derating") == 0
        return Signals(
            noise.deviation if noise else 0.0, seed, encoder.count if encoder else 0.0, bool(order),
            saturation.limit if saturation else inf, last, rounding.quantum if rounding else 0.0,
            _winding(warms, sample_time) if warms else Winding(),
        )  # fmt: skip


def _winding(derating: Any, sample_time: float) -> Winding:
    return Winding(
        derating.torque_limit, derating.thermal_resistance * derating.copper_loss, derating.ambient, derating.hot,
        derating.hot - derating.warm, -expm1(-sample_time / derating.time_constant),
    )  # fmt: skip

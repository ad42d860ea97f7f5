"""Many loops of one kind: their common part, and the numbers in which they differ."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.errors import InputError
from canhaptic.lab.batch.closed_loop import Losses
from canhaptic.lab.batch.event_plants import PlantValues
from canhaptic.lab.batch.signal_effects import SignalEffects
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.units import Parameters


class NotBatchableError(InputError, NotImplementedError):
    """A scene cannot run in a batch; run it one by one."""


@dataclass(frozen=True, slots=True)
class BatchCase:
    """The common part of many loops, and the numbers in which they differ.

    A linear plant is among the numbers; plants with events are separate, each different one once.

    `numbers` holds varied values by name: of the models `environment`, `passivity` and `loop` field by field; of the
    drive `counts_per_unit`, `torque_quantum` and `torque_limit`; of the meter `last_from`, `damping_per_time` and
    `friction`; `seed` of the encoder's noise; of plants with events `plant`, the place in `plants`; of a linear plant
    `start.ROW`, `flow.ROW.COLUMN` and, where it is known in closed form, `rate.ROW.COLUMN`. A
    name that is absent has the value of its model.
    """

    environment: Environment
    algorithm: str
    parameters: Parameters
    loop: LoopProperties
    delay: int
    furthest: float
    size: int  # of the plant's state vector [states..., torque, one]
    numbers: Mapping[str, Array | float | None]  # each of shape (n_scenes,) or one number
    signals: SignalEffects = field(default_factory=SignalEffects)
    plants: Sequence[PlantValues] = ()  # with events
    losses: Losses = field(default_factory=Losses)  # of frames


def floats_of(section: str, model: Parameters) -> dict[str, float]:
    """Return the numbers of a parameter model by the names of `BatchCase.numbers`."""
    fields = {f"{section}.{name}": getattr(model, name) for name in type(model).model_fields}
    return {name: value for name, value in fields.items() if isinstance(value, float)}

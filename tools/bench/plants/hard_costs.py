"""What hard plants cost: products and milliseconds of the mean and the dearest hold, interpreted.

Light bodies on stiff stops and under friction, 25 us to 25 ms; bristles and cogging at 25 ms; one hour of a wall.
A hold above 100 ms must have been announced: `run` and `check` print a line where `PlantModel.fastest_swing` is long.
"""

from collections.abc import Sequence
from math import sin
from time import perf_counter
from typing import Any, Final

from canhaptic.errors import EventLimitError
from canhaptic.scene.method import LONG_SWING
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.plant.read_effect import read_effect
from tools.bench.report import Row

US: Final = 1000
MS: Final = 1_000_000
DEAR: Final = 0.1  # [s] a hold, interpreted
_HOLDS: Final = 400
_LIMIT: Final = 10.0  # [s] for one case
_FRICTION: Final = {"type": "coulomb_friction", "kinetic": 0.5, "static": 0.8}
_LUGRE: Final = {
    "type": "lugre_friction", "kinetic": 0.5, "static": 0.8, "stribeck_velocity": 0.01, "bristle_stiffness": 1e5,
    "bristle_damping": 300.0,
}  # fmt: skip
_COGGING: Final = {"type": "cogging", "amplitude": 0.5, "pitch": 0.005}


def _stop(stiffness: float, damping: float = 0.0) -> dict[str, Any]:
    return {"type": "hard_stop", "position": 1e-3, "stiffness": stiffness, "damping": damping}


_CASES: Final[Sequence[tuple[str, float, Sequence[dict[str, Any]], int, float]]] = (
    *((f"{mass:.0e} kg under friction, {period / MS:g} ms", mass, (_FRICTION,), period, 0.5)
      for mass in (1e-6, 1e-9, 1e-12) for period in (25 * US, MS, 25 * MS)),
    *((f"1e-06 kg on 1e+09 N/m, {period / MS:g} ms", 1e-6, (_stop(1e9),), period, 0.5)
      for period in (25 * US, MS, 25 * MS)),
    ("1e-06 kg on 1e+09 N/m and friction, 1 ms", 1e-6, (_stop(1e9), _FRICTION), MS, 0.5),
    ("1e-06 kg on 1e+09 N/m, hand of 0.01 N*s/m, 1 ms", 1e-6, (_stop(1e9),), MS, 0.01),
    ("1e-12 kg on 1e+04 N/m, hand without damping, 0.025 ms", 1e-12, (_stop(1e4),), 25 * US, 0.0),
    ("1e-12 kg on 1e+09 N/m, 1 ms", 1e-12, (_stop(1e9),), MS, 0.5),
    ("LuGre friction, 25 ms", 0.25, (_LUGRE,), 25 * MS, 3.0),
    ("cogging, 25 ms", 0.25, (_COGGING,), 25 * MS, 3.0),
)  # fmt: skip


def moved(plant: Plant, holds: int) -> tuple[int, float, int, float, str]:
    """Return holds moved, time [s], products of the dearest hold, its time [s], and why it ended early."""
    plant.begin(0)
    most, longest, begin, why = 0, 0.0, perf_counter(), ""
    for hold in range(1, holds + 1):
        before, start = plant.products, perf_counter()
        try:
            plant.advance_to(hold * plant.sample_time_ns, 0.4 * sin(0.3 * hold))
        except EventLimitError as error:
            why = f"refused: {str(error).partition(',')[0]}"
        end = perf_counter()
        most, longest = max(most, plant.products - before), max(longest, end - start)
        if why or end - begin > _LIMIT:
            break
    return hold, perf_counter() - begin, most, longest, why


def cost_rows() -> list[Row]:
    """Return two rows for each case: milliseconds of the dearest hold, and its products."""
    rows = []
    for name, mass, effects, period, damping in _CASES:
        hand = UserParameters(stiffness=200, damping=damping, motion=SinusoidMotion(amplitude=0.01, frequency=1))
        plant = Plant(PlantParameters(mass=mass), hand, [read_effect(effect) for effect in effects], period)
        phase, _ = plant.scene.fastest_swing()
        holds, spent, most, longest, why = moved(plant, _HOLDS)
        announced = phase > LONG_SWING
        note = f"{1e3 * spent / holds:.2g} ms and {plant.products / holds:.3g} products a hold on average"
        note += f"; announced: {phase:.2g} rad" if announced else ""
        target = f"<= {1e3 * DEAR:g} or announced"
        rows.append(
            Row(f"{name}: dearest hold", 1e3 * longest, "ms", target=target, met=longest <= DEAR or announced,
                note=f"{note}; {why}" if why else note)
        )  # fmt: skip
        rows.append(Row(f"{name}: products of the dearest hold", most, "1"))
    return rows


def hour_row() -> Row:
    """Return what an hour at 1 kHz between two stops under friction costs; the balance of energies closes."""
    stops = [_stop(1e5, 20.0), {**_stop(1e5, 20.0), "position": -1e-3, "side": "lower"}]
    hand = UserParameters(stiffness=200, damping=1, motion=SinusoidMotion(amplitude=0.01, frequency=1))
    plant = Plant(PlantParameters(mass=0.25), hand, [read_effect(effect) for effect in (*stops, _FRICTION)], MS)
    plant.begin(0)
    begin = perf_counter()
    for hold in range(1, 3_600_001):
        plant.advance_to(hold * MS, 0.4 * sin(0.3 * hold))
    spent, energy = perf_counter() - begin, plant.energy()
    rest = abs(energy.motor + energy.user - energy.dissipated - energy.stored) / energy.dissipated
    note = f"{plant.products / hold:.3g} products a hold, {plant.events} events; balance closes to {rest:.1e}"
    return Row("one hour at 1 kHz, friction and two stops, a hold", 1e3 * spent / hold, "ms", met=rest < 1e-9,
               target="balance of energies to 1e-9", note=note)  # fmt: skip

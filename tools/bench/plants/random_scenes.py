"""Random scenes whose plants switch: friction, stops, backlash, current loops, hands, over ten decades of stiffness."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.propagator import Array
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.plant.read_effect import read_effect
from tools.chance import EXACT, Chance


@dataclass(frozen=True)
class RandomScene:
    """One plant and the torques that move it."""

    seed: int
    plant: PlantParameters
    user: UserParameters | None
    effects: tuple[Any, ...]
    period_ns: int
    torques: tuple[float, ...]

    def build(self, finer: int = 1, **accuracy: int) -> Plant:
        """Returns the plant, with a sample time `finer` times shorter."""
        settings = AccuracyParameters(**accuracy)
        return Plant(self.plant, self.user, self.effects, self.period_ns // finer, 1, settings)

    @property
    def names(self) -> str:
        """Names of its effects."""
        return "+".join(effect.type for effect in self.effects)

    def move(self, finer: int = 1, **accuracy: int) -> tuple[Plant, Array]:
        """Returns the plant after its run, and position, velocity and the four energies at every SYNC."""
        plant = self.build(finer, **accuracy)
        plant.begin(0)
        rows, now = [], 0
        for torque in self.torques:
            for _ in range(finer):
                now += plant.sample_time_ns
                plant.advance_to(now, torque)
            rows.append((plant.position, plant.velocity, *plant.energy()))
        return plant, np.array(rows)


def apart(scene: RandomScene, finer: int = 32) -> str:
    """Returns how a run differs from the same with its sample time cut, or nothing where it does not.

    An event is known to a tick, and every bounce amplifies what that leaves: a difference counts where it is larger
    than what ticks of different length make of the run by themselves.
    """
    (plant, whole), (cut, parts) = scene.move(), scene.move(finer)
    if plant.events != cut.events:
        return f"{plant.events} events, {cut.events} at T / {finer}"
    size = np.abs(parts).max(axis=0) + 1e-9
    off = np.abs(whole - parts).max(axis=0)
    if (off > 1e-6 * size).any():
        off -= 64.0 * np.abs(scene.move(finer // 4)[1] - parts).max(axis=0)
    worst = float((off / size).max())
    return f"{worst:.1e} of the largest value off" if worst > 1e-4 else ""


class _Chance(Chance):
    """Draws from one seed."""

    def decades(self, low: float, high: float, digits: int = EXACT) -> float:
        return super().decades(low, high, digits)


def random_scene(seed: int, friction: str = "coulomb_friction") -> RandomScene:
    """Returns the scene of a seed: at least one guard, sample time 0.1 to 20 ms, 15 to 40 holds.

    Args:
        seed: Of everything in it.
        friction: Type of its dry friction, where it has one.
    """
    chance = _Chance(seed, 18)
    period_ns = int(chance.generator.choice([100_000, 1_000_000, 5_000_000, 10_000_000, 20_000_000])) // 32 * 32
    effects = _effects(chance, friction)
    if any(effect["type"] == "current_loop" for effect in effects):
        effects += _supply(np.random.default_rng([seed, 39]))
    user = None
    if chance.drawn(0.7):
        user = UserParameters(
            stiffness=chance.decades(10.0, 1e4),
            damping=chance.decades(0.1, 100.0),
            rest=float(chance.generator.uniform(-0.01, 0.01)),
            motion=SinusoidMotion(amplitude=chance.decades(1e-3, 0.05), frequency=chance.decades(0.5, 10.0))
            if chance.drawn(0.6)
            else None,
        )
    plant = PlantParameters(
        mass=chance.decades(0.02, 1.0),
        damping=chance.decades(1e-2, 10.0),
        initial_velocity=float(chance.generator.uniform(-0.3, 0.3)) if chance.drawn(0.5) else 0.0,
    )
    largest, count = chance.decades(0.3, 10.0), int(chance.generator.integers(15, 40))
    torques = chance.generator.uniform(-largest, largest, count)
    if chance.drawn(0.3):
        torques = np.repeat(torques[::4], 4)
    return RandomScene(seed, plant, user, tuple(read_effect(e) for e in effects), period_ns, tuple(torques.tolist()))


def _supply(generator: np.random.Generator) -> list[dict[str, Any]]:
    """Returns a voltage limit in half of the scenes, drawn apart from everything else."""
    if generator.random() < 0.5:
        return []
    draws = {"supply": (0.3, 1.5), "back_emf": (-0.7, 0.7), "resistance": (-1.0, 1.0), "inductance": (-4.3, -2.3)}
    values = {name: float(10.0 ** generator.uniform(*decades)) for name, decades in draws.items()}
    return [{"type": "voltage_limit", **values}]


def _effects(chance: _Chance, friction: str) -> list[dict[str, Any]]:
    decades, drawn, effects = chance.decades, chance.drawn, []
    if drawn(0.6):
        kinetic = decades(0.03, 1.0)
        dry = {"type": friction, "kinetic": kinetic, "static": kinetic * float(chance.generator.uniform(1.0, 2.0))}
        effects.append(dry if friction == "coulomb_friction" else {**dry, "stribeck_velocity": decades(1e-3, 0.1)})
    if drawn(0.6):
        effects.append({"type": "current_loop", "time_constant": decades(5e-5, 5e-3)})
    if drawn(0.3):
        shaft = {"stiffness": decades(1e3, 1e6), "damping": decades(0.1, 30.0), "load_mass": decades(0.01, 0.5)}
        effects.append({"type": "shaft_compliance", **shaft})
        if drawn(0.5):
            effects.append({"type": "backlash", "gap": decades(1e-5, 1e-3)})
    if drawn(0.5) or not any(effect["type"] in (friction, "backlash") for effect in effects):
        for side, sign in (("upper", 1.0), ("lower", -1.0))[: 1 + int(drawn(0.4))]:
            stop = {"stiffness": decades(1e3, 1e6), "damping": decades(1.0, 300.0) if drawn(0.8) else 0.0}
            effects.append({"type": "hard_stop", "side": side, "position": sign * decades(5e-4, 2e-2), **stop})
    return effects

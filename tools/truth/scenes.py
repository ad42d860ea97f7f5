"""Random scenes over effect x timing x drive deviation x limit x algorithm, on one axis and on groups of two.

Every declaration is true but in the scenes tagged `false:`; `hand_force` and `hand_push` are guesses, which `judge`
raises to what the hand really did. What a scene names is in its tags, `dimension:name`; a table and the list of known
false claims go by them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from tools.chance import Chance
from tools.truth.changes import add_changes, record_the_hand
from tools.truth.five_bar import make_five_bar
from tools.truth.further import add_further
from tools.truth.programs import draw_program
from tools.truth.sums import SHARE, add_sum

SOURCE: Final = str(Path(__file__).resolve().parents[2] / "configs" / "truth.yaml")
"""Where paths of a scene start from."""
_RATES: Final = {40: 0.25, 100: 0.35, 250: 0.2, 500: 0.1, 1000: 0.1}
_BRAKES: Final = 0.05  # share of single axes
_RATE_OF_A_CHECK: Final = 250  # [Hz] at least: slower, it takes longer than the run
_CHECKS: Final = 0.02
"""Share of single axes at such a rate whose hold is checked at the start."""
_FIVE_BARS: Final = 0.4
"""Share of the stages that are a five-bar linkage instead."""
_RATES_OF_GROUPS: Final = {250: 0.5, 500: 0.3, 1000: 0.2}


@dataclass(frozen=True, slots=True)
class TruthScene:
    """One drawn scene."""

    seed: int
    values: dict[str, Any]
    tags: frozenset[str]
    outward: tuple[int, ...]  # of each axis: sign out of the wall; 0: along the torque
    duration: float = field(default=1.0)  # [s]
    begin: float = 0.0  # of a fault, from the first SYNC [s]

    @property
    def promises(self) -> bool:
        """Whether its algorithm certifies torques."""
        return "algorithm:guarded" in self.tags

    @property
    def is_true(self) -> bool:
        """Whether all that it declares is true, but for the hand."""
        return not any(tag.startswith("false:") for tag in self.tags)

    @property
    def passivity(self) -> dict[str, Any]:
        """The section that declares what is known of the hand."""
        section: dict[str, Any] = (
            self.values["groups"][0]["passivity"] if "groups" in self.values else (self.values["passivity"])
        )
        return section


class _Chance(Chance):
    """Draws from one seed, and notes what was drawn."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed, 19)
        self.tags: set[str] = set()

    def between(self, low: float, high: float) -> float:
        return float(f"{self.generator.uniform(low, high):.4g}")

    def by_weight(self, weights: Mapping[Any, float]) -> Any:
        total = sum(weights.values())
        names = list(weights)
        return names[int(self.generator.choice(len(names), p=[weight / total for weight in weights.values()]))]

    def named(self, dimension: str, weights: Mapping[str, float]) -> str:
        name: str = self.by_weight(weights)
        if name:
            self.tags.add(f"{dimension}:{name}")
        return name


def random_scene(seed: int, *, further: bool = True, changes: float | None = None, sums: float = SHARE) -> TruthScene:
    """Returns the scene of a seed.

    Args:
        seed: Any.
        further: Whether with what `add_further` and `add_changes` draw.
        changes: Share of the scenes in which something changes; None: the default of `add_changes`.
        sums: Share of the scenes whose environment becomes a sum, where `further` is true.
    """
    chance = _Chance(seed)
    group = chance.named("group", {"": 0.8, "xy_box": 0.1, "coupled_handles": 0.1})
    rate = chance.by_weight(_RATES_OF_GROUPS if group else _RATES)
    values: dict[str, Any] = {
        "bus": {"rate": rate, "rpdo": chance.named("rpdo", {"synchronous": 0.5, "event": 0.5})},
        "duration": chance.between(1.0, 1.8 if rate <= 100 else 1.1),
    }
    if rate <= 250 and chance.drawn(0.2):
        values["bus"]["bitrate"] = 500_000
    axis = _axis(chance)
    drive = _drive(chance, axis, values["bus"]["rpdo"])
    if not group:
        _draw_brake(np.random.default_rng([seed, 23]), axis, chance.tags)
    simulation: dict[str, Any] = {"seed": seed % 1_000_000, "drive": drive}
    values.update(axes=[axis], simulation=simulation)
    _bus_effects(chance, values, 1.0 / rate)
    outward = _group(chance, group, values) if group else _one_axis(chance, values)
    _declare_speed(axis, simulation, chance.tags)
    if group == "xy_box" and np.random.default_rng([seed, 21]).random() < _FIVE_BARS:
        chance.tags -= {"group:xy_box"}
        chance.tags.add("group:five_bar")
        make_five_bar(np.random.default_rng([seed, 22]), values)
    if further:
        outward = add_further(seed, values, chance.tags, outward)
        add_changes(seed, values, chance.tags, **({} if changes is None else {"share": changes}))
        record_the_hand(seed, values, chance.tags)
        outward = add_sum(seed, values, chance.tags, outward, sums)
    if outward == (0,) and "algorithm:guarded" in chance.tags:
        _declare_push(np.random.default_rng([seed, 16]), values, chance.tags)
        outward = draw_program(seed, values, chance.tags, outward)
    _declare_falsely(chance, values)
    if rate >= _RATE_OF_A_CHECK and further:
        _check_hold(np.random.default_rng([seed, 41]), values, chance.tags)
    chance.tags.add(f"rate:{rate}")
    return TruthScene(seed, values, frozenset(chance.tags), outward, values["duration"])


def _declare_speed(axis: dict[str, Any], simulation: dict[str, Any], tags: set[str]) -> None:
    """Declares the speed above which the supply no longer holds a current, where the torque is measured.

    There the motor brakes by its back-EMF, with a torque that was not commanded; a rig stops for it, and rightly so.
    """
    for effect in simulation.get("effects", ()):
        if effect["type"] == "voltage_limit" and "drive:read_actual" in tags:
            axis["speed_limit"] = min(10.0, float(f"{0.9 * effect['supply'] / effect['back_emf']:.3g}"))


def _check_hold(random: np.random.Generator, values: dict[str, Any], tags: set[str]) -> None:
    """Checks the hold at the start of some scenes of one axis; the drives of half of them act in another hold."""
    if "groups" in values or "false:hold" in tags or random.random() >= _CHECKS:
        return
    values["axes"][0]["check_hold"] = "each_start"
    is_other = random.random() < 0.5 and values["bus"]["rpdo"] == "synchronous" and "drive:acts_a_sync_late" not in tags
    if is_other:
        values["simulation"]["drive"].update({"acts_at_once": True} if random.random() < 0.5 else {"syncs_late": 1})
    tags.add("hold:other" if is_other else "hold:checked")


def _declare_push(random: np.random.Generator, values: dict[str, Any], tags: set[str]) -> None:
    """Declares the push of the hand where an environment turns, and makes some slots narrow."""
    section, environment = values["passivity"], values["environment"]
    if section.get("hand_force") is not None:
        section.setdefault("hand_push", float(f"{10.0 ** random.uniform(0.3, 1.3):.4g}"))
        tags.add("declares:hand_push")
    if isinstance(environment, dict) and environment["type"] == "two_sided_wall" and random.random() < 0.5:
        environment["upper"] = float(f"{10.0 ** random.uniform(-4.0, -2.0):.4g}")


def _declare_falsely(chance: _Chance, values: dict[str, Any]) -> None:
    """Makes one declaration in twenty scenes false; a row of the table says how often a run notices."""
    if not chance.drawn(0.05):
        return
    group = values.get("groups")
    passivity = group[0]["passivity"] if group else values["passivity"]
    kind = chance.by_weight({"moving_mass": 0.3, "current_lag": 0.3, "torque_window": 0.15, "counts_per_unit": 0.25})
    effects, bus = values["simulation"].get("effects", ()), values["simulation"].get("bus", {})
    lag = max((effect["time_constant"] for effect in effects if effect["type"] == "current_loop"), default=0.0)
    window = 2.0 * bus.get("delay", 0.0) if values["bus"]["rpdo"] == "event" and "ids" not in bus else 0.0
    late = {"current_lag": lag, "torque_window": window}
    if kind == "moving_mass":
        passivity["moving_mass"] *= 3.0
    elif kind == "counts_per_unit":
        values["simulation"]["drive"]["counts_per_unit"] = 1.2 * values["axes"][0]["counts_per_unit"]
    elif late.get(kind, 0.0) > 0.0:  # an explicit 0 is refused
        passivity[kind] = chance.between(0.05, 0.6) * late[kind]
    else:
        return
    chance.tags.add(f"false:{kind}")


def _axis(chance: _Chance) -> dict[str, Any]:
    axis: dict[str, Any] = {
        "name": "handle", "node_id": 1, "eds": "cia402_servo.eds", "unit": "m",
        "counts_per_unit": chance.by_weight({1e6: 0.6, 1e5: 0.2, 1e7: 0.2}),
        "rated_torque": 20.0, "torque_limit": 30.0,
    }  # fmt: skip
    limit = chance.named("limit", {"": 0.7, "torque_limit": 0.1, "torque_rate_limit": 0.1, "power_limit": 0.05})
    if limit == "torque_limit":
        axis["torque_limit"] = chance.between(1.0, 5.0)
    elif limit == "torque_rate_limit":
        axis["torque_rate_limit"] = chance.decades(50.0, 5000.0)
    elif limit == "power_limit":
        axis["power_limit"] = chance.decades(0.05, 5.0)
    return axis


def _draw_brake(chance: np.random.Generator, axis: dict[str, Any], tags: set[str]) -> None:
    """Gives one axis of twenty a brake, which the simulated drive has too, and opens after up to 80 ms."""
    if chance.random() < _BRAKES:
        axis["brake"] = {"release_time": float(chance.uniform(0.0, 0.08)), "set_time": float(chance.uniform(0.0, 0.08))}
        tags.add("brake")


def _drive(chance: _Chance, axis: dict[str, Any], rpdo: str) -> dict[str, Any]:
    drive: dict[str, Any] = {"objects": {"0x6502": 0x200}}
    next_shown = 0.06 if rpdo == "synchronous" else 0.0  # else nothing is updated at a SYNC
    deviation = chance.named(
        "drive",
        {"": 0.6, "read_actual": 0.1, "read_none": 0.06, "floor": 0.06, "after_update": next_shown,
         "own_limit": 0.06, "per_cent": 0.06, "turned": 0.04},
    )  # fmt: skip
    if deviation == "read_actual":
        axis["read_back"] = "actual"
        if chance.drawn(0.5):
            drive["torque_lag"] = chance.decades(1e-4, 2e-3)
            chance.tags.add("drive:torque_lag")
    elif deviation == "read_none":
        axis["read_back"] = "none"
    elif deviation == "floor":
        drive["encoder"] = "floor"
    elif deviation == "after_update":
        axis["demand_reported"] = "after"
    elif deviation == "own_limit":
        drive["torque_limit"] = chance.between(1.0, 5.0)
    elif deviation == "per_cent":
        axis["quirks"] = ["torque_per_cent"]
    elif deviation == "turned":
        axis["direction"] = -1
    return drive


def _bus_effects(chance: _Chance, values: dict[str, Any], period: float) -> None:
    timing = chance.named(
        "timing",
        {"": 0.55, "wire_time": 0.12, "sync_jitter": 0.12, "sync_late": 0.06, "delay": 0.05, "stall": 0.05,
         "drop": 0.05},
    )  # fmt: skip
    sync = {"ids": [0x80], "direction": "to_drive"}
    if timing == "wire_time":
        values["simulation"]["bus"] = {"wire_time": True}
    elif timing == "sync_jitter":
        values["simulation"]["bus"] = {"jitter": chance.between(0.01, 0.2) * period, **sync}
    elif timing == "sync_late":
        late = {"begin": 0.0, "duration": 1.2 * period, "every": 8.0 * period}
        values["simulation"]["bus"] = {"delay": chance.between(0.1, 0.49) * period, "during": [late], **sync}
    elif timing == "delay":
        values["simulation"]["bus"] = {"delay": chance.between(0.02, 0.15) * period}
    elif timing == "stall":
        stall = {"begin": 0.2, "duration": chance.between(0.2, 4.0) * period, "every": chance.between(0.2, 0.5)}
        values["simulation"]["bus"] = {"stall": [stall]}
    elif timing == "drop":
        values["simulation"]["bus"] = {"drop": chance.decades(1e-3, 2e-2)}


def _plant(chance: _Chance) -> dict[str, Any]:
    return {
        "mass": chance.decades(0.08, 1.0),
        "damping": chance.decades(0.02, 3.0),
        "initial_position": chance.between(0.002, 0.008),
    }


def _hand(chance: _Chance) -> dict[str, Any]:
    """Returns a hand that meets a wall at 0 which is solid below."""
    kind = chance.named("hand", {"press": 0.45, "tap": 0.4, "shake": 0.15})
    if kind == "press":
        return {"push": -chance.between(1.0, 20.0), "damping": chance.decades(0.1, 3.0)}
    frequency = chance.between(0.8, 2.0) if kind == "tap" else chance.between(3.0, 8.0)
    motion = {"type": "sinusoid", "amplitude": chance.decades(0.008, 0.04), "frequency": frequency}
    return {"stiffness": chance.decades(60.0, 800.0), "damping": chance.between(0.5, 6.0), "motion": motion}


def _environment(chance: _Chance) -> tuple[dict[str, Any], int]:
    """Returns an environment and the sign of the direction out of it."""
    kind = chance.named(
        "environment",
        {"spring_damper_wall": 0.6, "hardening_wall": 0.08, "damper_wall": 0.08, "two_sided_wall": 0.08,
         "viscoelastic_medium": 0.05, "coulomb_surface": 0.05, "viscous_medium": 0.06},
    )  # fmt: skip
    stiffness, damping = chance.decades(100.0, 20_000.0), chance.between(0.0, 15.0) if chance.drawn(0.5) else 0.0
    common = {"type": kind, "stiffness": stiffness, "damping": damping}
    own: dict[str, Any] = {
        "spring_damper_wall": {"position": 0.0},
        "hardening_wall": {"position": 0.0, "hardening": stiffness * chance.decades(1e3, 1e5)},
        "two_sided_wall": {"lower": 0.0, "upper": 0.012},
        "viscoelastic_medium": {"relaxation_time": chance.decades(0.05, 1.0)},
        "coulomb_surface": {"friction": chance.between(0.6, 5.0)},
    }
    if kind == "viscous_medium":
        return {"type": kind, "damping": chance.decades(1.0, 50.0)}, 0
    if kind == "damper_wall":
        return {"type": kind, "damping": chance.decades(5.0, 100.0), "position": 0.0}, 1
    return {**common, **own[kind]}, 1 if kind in ("spring_damper_wall", "hardening_wall") else 0


def _effects(chance: _Chance) -> list[dict[str, Any]]:
    count = chance.by_weight({0: 0.35, 1: 0.4, 2: 0.25})
    weights = {
        "current_loop": 0.2, "coulomb_friction": 0.12, "shaft_compliance": 0.08, "viscous_friction": 0.06,
        "tremor": 0.08, "grasp_change": 0.05, "cogging": 0.08, "torque_ripple": 0.06, "torque_quantisation": 0.06,
        "torque_saturation": 0.06, "thermal_derating": 0.04, "encoder_noise": 0.06, "encoder_quantisation": 0.06,
        "stribeck_friction": 0.04, "lugre_friction": 0.03, "hard_stop": 0.05, "backlash": 0.04,
    }  # fmt: skip
    effects: list[dict[str, Any]] = []
    for _ in range(count):
        kind = chance.by_weight(weights)
        exclusive = {"coulomb_friction", "stribeck_friction", "lugre_friction"}
        if any(e["type"] == kind or {e["type"], kind} <= exclusive for e in effects):
            continue
        if kind == "backlash" and not any(e["type"] == "shaft_compliance" for e in effects):
            continue
        chance.tags.add(f"effect:{kind}")
        effects.append({"type": kind, **_effect(chance, kind)})
    if any(effect["type"] == "current_loop" for effect in effects):
        effects += _supply(chance)
    return effects


def _supply(chance: _Chance) -> list[dict[str, Any]]:
    """Returns a voltage limit in a third of the scenes with a current loop, drawn apart from everything else."""
    apart = _Chance(int(chance.generator.bit_generator.state["state"]["state"] % 2**32))
    if not apart.drawn(0.33):
        return []
    chance.tags.add("effect:voltage_limit")
    winding = {"back_emf": apart.decades(0.5, 10.0), "resistance": apart.decades(0.1, 5.0)}
    return [{"type": "voltage_limit", "supply": apart.decades(8.0, 80.0), **winding,
             "inductance": apart.decades(1e-4, 5e-3)}]  # fmt: skip


def _effect(chance: _Chance, kind: str) -> dict[str, Any]:
    """Returns the values of one effect."""
    decades, between = chance.decades, chance.between
    kinetic = decades(0.05, 2.0)
    dry = {"kinetic": kinetic, "static": kinetic * between(1.0, 1.5)}
    smooth = {**dry, "stribeck_velocity": decades(5e-3, 5e-2)}
    makers: dict[str, Any] = {
        "current_loop": lambda: {"time_constant": decades(3e-5, 1e-3)},
        "coulomb_friction": lambda: dry,
        "stribeck_friction": lambda: smooth,
        "lugre_friction": lambda: {**smooth, "bristle_stiffness": decades(1e4, 1e5), "viscous": 0.1},
        "shaft_compliance": lambda: {
            "stiffness": decades(2e3, 1e5), "damping": decades(0.5, 10.0), "load_mass": decades(0.03, 0.3)
        },
        "backlash": lambda: {"gap": decades(1e-5, 5e-4)},
        "viscous_friction": lambda: {"damping": decades(0.05, 2.0)},
        "tremor": lambda: {"amplitude": decades(1e-4, 1e-3), "frequency": between(7.0, 12.0)},
        "grasp_change": lambda: {"time": between(0.2, 0.8), "stiffness": decades(60.0, 600.0), "damping": 3.0},
        "cogging": lambda: {"amplitude": decades(0.02, 0.5), "pitch": decades(2e-3, 2e-2)},
        "torque_ripple": lambda: {"amplitude": decades(0.003, 0.05), "pitch": decades(2e-3, 2e-2)},
        "torque_quantisation": lambda: {"quantum": decades(0.005, 0.1)},
        "torque_saturation": lambda: {"limit": between(1.0, 8.0)},
        "thermal_derating": lambda: {
            "torque_limit": 8.0, "copper_loss": 1.0, "thermal_resistance": 2.0, "time_constant": 1.0
        },
        "encoder_noise": lambda: {"deviation": decades(1e-7, 3e-6)},
        "encoder_quantisation": lambda: {"count": decades(1e-6, 2e-5)},
        "hard_stop": lambda: {"side": "upper", "position": 0.05, "stiffness": 1e4, "damping": 20.0},
    }  # fmt: skip
    values: dict[str, Any] = makers[kind]()
    return values


def _one_axis(chance: _Chance, values: dict[str, Any]) -> tuple[int, ...]:
    plant, user = _plant(chance), _hand(chance)
    effects = _effects(chance)
    environment, outward = _environment(chance)
    kinds = {effect["type"] for effect in effects}
    if kinds & {"tremor", "grasp_change"} and not user.get("stiffness"):
        user.update(stiffness=chance.decades(60.0, 400.0), damping=3.0, rest=-0.01)
    values["environment"] = environment
    values["simulation"].update(plant=plant, user=user, effects=effects)
    algorithm = chance.named(
        "algorithm",
        {"guarded": 0.7, "unprotected": 0.08, "internal_dissipation": 0.08, "passivity_observer": 0.06,
         "energy_bounding": 0.04, "a_priori_dissipation": 0.04},
    )  # fmt: skip
    damping = plant["damping"] + sum(e["damping"] for e in effects if e["type"] == "viscous_friction")
    passivity = {"algorithm": algorithm, **_loop(chance, plant["mass"], damping)}
    if algorithm == "energy_bounding":
        passivity["device_damping"] = damping
    if algorithm == "guarded":
        passivity["hand_force"] = 0.0 if "hand:press" in chance.tags else chance.decades(1.0, 10.0)
        if chance.drawn(0.5):
            chance.tags.add("declares:hand_push")
            passivity["hand_push"] = chance.decades(5.0, 20.0)
    values["passivity"] = passivity
    return (outward,)


def _loop(chance: _Chance, mass: float, damping: float) -> dict[str, Any]:
    loop: dict[str, Any] = {
        "moving_mass": mass * chance.between(0.7, 1.0),
        "device_damping_bound": damping * chance.between(1.2, 2.0) + 0.2,
    }
    if chance.drawn(0.3):
        chance.tags.add("declares:device_damping")
        loop["device_damping"] = damping * chance.between(0.5, 1.0)
    return loop


def _group(chance: _Chance, group: str, values: dict[str, Any]) -> tuple[int, ...]:
    first = values["axes"][0]
    first["name"] = "x"
    values["axes"] = [first, {**first, "name": "y", "node_id": 2}]
    algorithm = chance.named("algorithm", {"guarded": 0.8, "unprotected": 0.08, "step_scaling": 0.12})
    plant, simulation = _plant(chance), values["simulation"]
    if chance.drawn(0.3) and "limit:" not in str(chance.tags):
        simulation["effects"] = [{"type": "current_loop", "time_constant": chance.decades(3e-5, 1e-3)}]
        if group == "coupled_handles":
            chance.tags.add("effect:current_loop")
    network: dict[str, Any] = {"stiffness": chance.decades(100.0, 5000.0), "damping": chance.between(0.0, 10.0)}
    if group == "coupled_handles":
        network["type"] = "coupled_handles"
        simulation["plant"] = {"mass": plant["mass"], "damping": plant["damping"]}
        simulation["axes"] = {"x": {"user": _swing(chance, 0.0)}, "y": {"user": _swing(chance, 1.0)}}
    else:
        simulation.pop("effects", None)
        network.update(type="box", lower=[-0.012, -0.012], upper=[0.012, 0.012])
        hand = {"stiffness": chance.decades(80.0, 500.0), "damping": chance.between(1.0, 6.0)}
        motion = {name: _swing(chance, 1.57 * place)["motion"] for place, name in enumerate("xy")}
        masses = {"mass_x": plant["mass"], "mass_y": plant["mass"]}
        stage = {"type": "xy_stage", "axes": ["x", "y"], **masses, "damping_x": plant["damping"]}
        simulation["mechanisms"] = [{**stage, "damping_y": plant["damping"], "hand": {**hand, "motion": motion}}]
    passivity = {"algorithm": algorithm, **_loop(chance, plant["mass"], plant["damping"])}
    if algorithm == "guarded":
        passivity["hand_force"] = chance.decades(0.5, 4.0)
        if chance.drawn(0.3):
            passivity["max_consecutive_losses"] = 1
    both = {"axes": ["x", "y"], "network": network, "passivity": passivity}
    values["groups"] = [{"name": "pair", **both}]
    return (0, 0)


def _swing(chance: _Chance, phase: float) -> dict[str, Any]:
    motion = {"amplitude": chance.decades(0.02, 0.05), "frequency": chance.between(0.6, 2.0), "phase": phase}
    return {"stiffness": chance.decades(60.0, 500.0), "damping": chance.between(1.0, 5.0), "motion": motion}

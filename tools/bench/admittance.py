"""Do admittance displays keep their promise, and what does it cost? Judged by the plant's own energy at the sensor.

Random displays (account, every effect of the sensor, losses); the mass felt and the energy given out against the mass
asked, for every algorithm and rate; the borders of the plain virtual mass by the eigenvalues of the sampled loop; the
paper's algorithm; faults over CAN; what the bus carries.
"""

import argparse
from collections.abc import Callable
from dataclasses import asdict, replace
from math import pi
from random import Random
from statistics import median
from typing import Any

import numpy as np
from scipy.linalg import expm

from canhaptic.control.admittance import DISPLAY_ALGORITHMS
from canhaptic.control.admittance.admittance_environment import AdmittanceMass
from canhaptic.control.admittance.declared_hand import damping_border
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.drive.can.bus_budget import bus_budget
from canhaptic.scene.build import build
from canhaptic.scene.buses import can_bus
from canhaptic.scene.load import load_scene
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from canhaptic.sim.plant.velocity_drive import (
    AdmittanceSimulation,
    GripParameters,
    SimulatedForceSensor,
    VelocityLoopParameters,
)
from canhaptic.view.picture_style import BLUE, GREEN, ORANGE, PURPLE, VERMILION, drawing, save_picture
from tools.bench.report import Row, picture_place, publish
from tools.displays import faults
from tools.displays.direct import Display, Outcome
from tools.displays.direct import run as run_direct
from tools.displays.pace import cycles_per_second
from tools.displays.random_display import with_true_bounds
from tools.displays.random_rows import group_rows, random_rows

_PACKAGES = ("canhaptic", "numpy", "scipy")
_MASS, _BANDWIDTH = 2.0, 50.0
_Hand = tuple[float, float, float, float]
_GAIN = 2.0 * pi * _BANDWIDTH * _MASS
_RATES = (250, 500, 1000)
_TWO_BUSES_AT = 500  # [Hz]
_DEMO = faults.SCENE.parents[1] / "demo.yaml"
_ASKED = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0)
_NOTHING = 1e-6  # energy drawn for none [J]
_HEAVY = 6.5  # above M + c tau at the lowest rate, where none of the others is [kg]


def _display(rate: int, asked: float, algorithm: str, seed: int, *, damping: float = 5.0) -> Display:
    """Returns the rig of the figures: 2 kg, a loop of 50 Hz, the force as a mean, and one of many hands."""
    random = Random(seed)
    properties = AdmittanceProperties(
        sample_time=1.0 / rate, delay=1, sampling="mean", force_slew=5e3, handle_acceleration=20.0, encoder_count=1e-6,
        speed_limit=2.0, acceleration_limit=500.0,
    )  # fmt: skip
    guarded = GuardedAdmittanceParameters(drive_mass=_MASS, loop_gain=_GAIN, energy_allowance=1e-3, spread=0.1)
    grip = GripParameters(
        mass=random.choice([0.05, 0.3, 1.0, 3.0]),
        stiffness=random.choice([2e3, 1e4, 3e4]),
        damping=random.choice([0.5, 5.0]),
    )
    hand = UserParameters(
        stiffness=random.choice([100.0, 500.0, 2000.0]), damping=random.choice([0.5, 5.0]),
        motion=SinusoidMotion(amplitude=random.choice([0.02, 0.05]), frequency=random.uniform(0.5, 3.0)),
    )  # fmt: skip
    loop = VelocityLoopParameters(gain=_GAIN)
    return Display(
        PlantParameters(mass=_MASS, damping=0.0),
        AdmittanceSimulation(loop=loop, grip=grip, sensor=SimulatedForceSensor(sampling="mean")), hand,
        AdmittanceMass(mass=asked, damping=damping), properties, algorithm, guarded if algorithm == "guarded" else None,
    )  # fmt: skip


def mass_felt(outcome: Outcome, time: float) -> float:
    """Returns the mass that fits true force and velocity best [kg]: F = m v' + b v + F_0."""
    force, speed = np.array(outcome.forces[20:]), np.array(outcome.velocities[20:])
    middle = 0.5 * (speed[2:] + speed[:-2]), (speed[2:] - speed[:-2]) / (2.0 * time)
    rows = np.stack([middle[1], middle[0], np.ones(len(middle[0]))], axis=1)
    return float(np.linalg.lstsq(rows, force[1:-1], rcond=None)[0][0])


def _as_seen(display: Display, cycles: int) -> Display:
    """Returns a display that declares half as much again as the slew and acceleration that a run of it shows.

    What is declared beyond that acts on the account like dry friction.
    """
    found = run_direct(display, cycles)
    bounds = {"force_slew": 1.5 * found.slew, "handle_acceleration": 1.5 * found.acceleration}
    return replace(display, properties=display.properties.model_copy(update=bounds))


def masses(hands: int, seconds: float) -> list[dict[str, Any]]:
    """Returns, for rate, mass asked and algorithm: mass felt, least energy, part of the holds that the guard cut."""
    found = []
    for rate in _RATES:
        for asked in (*_ASKED, _HEAVY) if rate == _RATES[0] else _ASKED:
            for name in DISPLAY_ALGORITHMS if asked != _HEAVY else ("guarded",):
                cycles = round(seconds * rate)
                displays = [_as_seen(_display(rate, asked, name, seed), cycles) for seed in range(hands)]
                judged = [with_true_bounds(display, cycles, keeps=True) for display in displays]
                outcomes = [one[1] for one in judged if one is not None]
                calm = [o for o in outcomes if o.speed < 1.5]
                moving = sum(o.moving for o in outcomes)
                found.append(
                    {
                        "rate": rate, "asked": asked, "algorithm": name,
                        "felt": median(mass_felt(o, 1.0 / rate) for o in calm) if calm else None,
                        "least": min(o.least for o in outcomes), "below": sum(o.least < -2e-3 for o in outcomes),
                        "cut": sum(o.cut for o in outcomes) / moving if moving else 0.0, "hands": len(outcomes),
                    }
                )  # fmt: skip
    return found


def mass_rows(found: list[dict[str, Any]]) -> list[Row]:
    """AD4 and AD5."""
    rows = []
    for rate in _RATES:
        never = _MASS + _GAIN * 1.5 / rate
        guard = [f for f in found if f["rate"] == rate and f["algorithm"] == "guarded"]
        plain = [f for f in found if f["rate"] == rate and f["algorithm"] == "unprotected"]
        passive = [f for f in guard if f["asked"] >= 1.05 * never]
        least = min(f["least"] for f in guard)
        rows.append(Row(f"{rate} Hz: least energy, guarded", least, "J", target=">= -1 mJ", met=least >= -1e-3 - 1e-9))
        if passive:
            cut = max(f["cut"] for f in passive)
            rows.append(Row(f"AD4 {rate} Hz: guard acts above M + c tau", cut, "1", target="<= 0.01", met=cut <= 0.01))
            off = max(abs(f["felt"] / f["asked"] - 1.0) for f in passive if f["felt"])
            rows.append(
                Row(f"AD4 {rate} Hz: mass felt off the mass asked", off, "1", target="<= 0.02", met=off <= 0.02)
            )
        light = next(f for f in guard if f["asked"] == _ASKED[0])
        most = _MASS + _GAIN / rate
        rows += [
            Row(f"{rate} Hz: guard acts at 0.5 kg", light["cut"], "1", note="part of the moving holds"),
            Row(f"AD5 {rate} Hz: 0.5 kg guarded, mass felt", light["felt"], "kg", "M + (1 + d) c T / 2", most,
                light["felt"] / most, "<= 1", light["felt"] <= most),
        ]  # fmt: skip
        light = next(f for f in plain if f["asked"] == _ASKED[0])
        rows.append(
            Row(
                f"AD5 {rate} Hz: 0.5 kg unprotected, least energy",
                light["least"],
                "J",
                note=f"{light['below']} of {light['hands']} hands below 0",
            )
        )
    return rows


def _is_stable(rate: int, delay: int, mass: float, damping: float, hand: _Hand) -> bool:
    """Whether the sampled loop of a virtual mass with the mean force of a hold is stable with a hand.

    The hand: grip stiffness and damping, mass behind it, stiffness to ground from there.
    """
    k, b, behind, ground = hand
    time, states = 1.0 / rate, 6  # q, v, x, w, impulse, command
    a = np.zeros((states, states))
    a[0, 1], a[2, 3] = 1.0, 1.0
    pull = np.array([-k, -b, k, b, 0.0, 0.0])
    a[1] = pull / _MASS
    a[1, 1] -= _GAIN / _MASS
    a[1, 5] = _GAIN / _MASS
    a[3] = -pull / behind
    a[3, 2] -= ground / behind
    a[4] = pull
    flow = expm(a * time)
    size = states + delay  # model speed in the place of the command; commands under way
    step = np.zeros((size, size))
    held = np.zeros(size)
    held[size - 1 if delay else 5] = 1.0  # the command that acts
    body = np.zeros((5, size))
    body[:, :5] = flow[:5, :5]
    body[:, 4] -= flow[:5, 4]  # the impulse begins anew
    body += np.outer(flow[:5, 5], held)
    step[:5] = body
    step[5] = (mass * np.eye(size)[5] + body[4]) / (mass + time * damping)
    if delay:
        step[6] = np.eye(size)[5]  # what was computed acts a hold later
        for place in range(7, size):
            step[place] = np.eye(size)[place - 1]
    return bool(np.abs(np.linalg.eigvals(step)).max() < 1.0 + 1e-7)


def border_rows() -> list[Row]:
    """AD6: least virtual mass without damping for many hands, and least damping against a spring to ground."""
    hands = [(k, 1e-3, m, 0.0) for k in np.logspace(2, 7, 60) for m in (0.05, 0.3, 2.0, 20.0, 1e6)]
    rows = [_mass_row(rate, delay, hands) for rate, delay in ((1000, 0), (1000, 1), (1000, 3), (250, 1))]
    for stiffness, rate in ((1000.0, 1000), (5000.0, 1000), (5000.0, 250)):
        rows += _damping_rows(stiffness, rate)
    return rows


def _mass_row(rate: int, delay: int, hands: list[_Hand]) -> Row:
    least = _least(0.1, 30.0, lambda mass: all(_is_stable(rate, delay, mass, 1e-4, hand) for hand in hands))
    said = _MASS + _GAIN * (delay + 0.5) / rate
    name, ratio = f"AD6 border {rate} Hz, delay {delay}", least / said
    return Row(name, least, "kg", "M + c tau", said, ratio, "0.5 %", abs(ratio - 1.0) <= 5e-3)


def _damping_rows(stiffness: float, rate: int) -> list[Row]:
    mass, lag, hand = 0.5, 1.5 / rate, (stiffness, 1e-6, 1e6, 0.0)
    least = _least(0.0, 500.0, lambda damping: _is_stable(rate, 1, mass, damping, hand))
    said, simple = damping_border(_MASS, _GAIN, mass, stiffness, lag), stiffness * (lag + (_MASS - mass) / _GAIN)
    name, ratio, rough = f"AD6 damping against {stiffness:g} N/m, {rate} Hz", least / said, least / simple
    good = 0.9 <= rough <= 1.0 + 1e-6
    why = "" if good else "the first order of the row before; with sqrt(K / m) tau not small it asks for more"
    return [
        Row(name, least, "N*s/m", "damping_border", said, ratio, "2 %", abs(ratio - 1.0) <= 0.02),
        Row(f"{name}: short form", least, "N*s/m", "K (tau + (M - m) / c)", simple, rough, "0.9..1", good, why),
    ]


def _least(low: float, high: float, is_stable: Callable[[float], bool]) -> float:
    """Returns the least stable value between an unstable and a stable one."""
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if is_stable(middle) else (middle, high)
    return high


def fault_rows() -> tuple[list[Row], list[dict[str, Any]]]:
    """AD10: faults over CAN."""
    found = [faults.outcome(name) for name in faults.FAULTS]
    rows = [
        Row(
            f"AD10 {f.fault}: energy given out",
            f.given,
            "J",
            note=f"{f.stopped_by or 'goes on'}, after {f.stop:.3f} s, still {f.still:.2f} s later, "
            f"{f.fastest:.2f} m/s; {f.by_fault:.2g} J more than without",
        )
        for f in found
    ]
    worst, missed = faults.worst_offset(5.0)
    note = f"20 runs, {missed} not found, friction declared; against the same run without the offset"
    good = missed == 0 and worst.by_fault < 0.1
    rows.append(Row("AD10 5 N offset: energy given out", worst.by_fault, "J", target="< 0.1", met=good, note=note))
    return rows, [asdict(f) for f in found]


def bus_rows() -> list[Row]:
    """How many axes one bus carries, and the pace of a cycle against that of the demo."""
    scene = load_scene(faults.SCENE)
    with build(scene, "free") as experiment:
        one = experiment.rig.drives[0].map
    rows = []
    for rate in (1000, 500, 250):
        bus = can_bus(scene.bus).model_copy(update={"rate": float(rate)})
        axes = next(n for n in range(1, 40) if not bus_budget(bus, [one] * (n + 1)).fits)
        rows.append(Row(f"axes on one bus at {rate} Hz, force in the TPDO", axes, "1"))
        if rate == _TWO_BUSES_AT:
            rows.append(Row(f"the same on two buses at {rate} Hz", 2 * axes, "1", target=">= 6", met=2 * axes >= 6))
    pace = {name: cycles_per_second(scene) for name, scene in (("display", scene), ("demo", load_scene(_DEMO)))}
    share, alone = (pace["display"][part] / pace["demo"][part] for part in (0, 1))
    return [
        *rows,
        Row("cycles/s flat out", pace["display"][0], "1/s", "demo (torque)", pace["demo"][0], share, ">= 0.9",
            share >= 0.9, "without the start; with the simulated drive, its sensor and the plant"),
        Row("the same without the simulated side", pace["display"][1], "1/s", "demo (torque)", pace["demo"][1], alone,
            ">= 0.9", alone >= 0.9, "what runs with a real drive"),
    ]  # fmt: skip


def draw(found: list[dict[str, Any]], place: Any) -> None:
    """Draws mass felt and energy given out against the mass asked, one column for each rate."""
    with drawing() as figure_type:
        figure = figure_type(figsize=(12, 7), dpi=110, layout="constrained")
        axes = figure.subplots(2, len(_RATES), sharex=True, sharey="row")
        for column, rate in enumerate(_RATES):
            rows = [f for f in found if f["rate"] == rate and f["asked"] in _ASKED]
            _draw_rate(axes[0][column], axes[1][column], rows, _MASS + _GAIN * 1.5 / rate)
            axes[0][column].set_title(f"{rate} Hz", fontweight="bold")
        axes[0][0].set_ylabel("mass felt, median of the hands [kg]")
        axes[1][0].set_ylabel("energy given out, worst hand [J]")
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
        save_picture(figure, place)


def _draw_rate(felt: Any, given: Any, rows: list[dict[str, Any]], never: float) -> None:
    """Draws one rate; the picture says from which mass on no guard is needed."""
    felt.plot(_ASKED, _ASKED, color="#D0D0D0", linewidth=7, label="asked")
    others = [name for name in DISPLAY_ALGORITHMS if name != "guarded"]
    colours = {"guarded": "black", **dict(zip(others, (BLUE, PURPLE, GREEN, ORANGE, VERMILION), strict=True))}
    for name, colour in colours.items():
        own = [f for f in rows if f["algorithm"] == name]
        style: dict[str, Any] = {"color": colour, "label": name, "linewidth": 1.2, "marker": "o", "markersize": 3}
        if name == "guarded":
            style |= {"linewidth": 2.6, "zorder": 4}
        felt.plot([f["asked"] for f in own if f["felt"]], [f["felt"] for f in own if f["felt"]], **style)
        given.plot([f["asked"] for f in own], [max(_NOTHING, -f["least"]) for f in own], **style)
    for panel in (felt, given):
        panel.axvline(never, color="#606060", linestyle=":")
    felt.text(never - 0.08, 0.3, f"passive without a guard\nfrom {never:.1f} kg", ha="right", fontsize=8.0)
    given.set_yscale("log")
    given.set_yticks([_NOTHING, 1e-4, 1e-2, 1.0, 100.0], ["nothing", "1e-4", "0.01", "1", "100"])
    given.set_xlabel("mass asked [kg]")


def main() -> None:
    """Measures everything, prints the table and writes the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000, help="random displays")
    parser.add_argument("--groups", type=int, default=200, help="random groups of two displays or three")
    parser.add_argument("--hands", type=int, default=12, help="hands for each mass, rate and algorithm")
    arguments = parser.parse_args()
    fault_part, table = fault_rows()
    found = masses(arguments.hands, 1.5)
    rows = [
        *random_rows(arguments.runs),
        *group_rows(arguments.groups),
        *mass_rows(found),
        *border_rows(),
        *fault_part,
        *bus_rows(),
    ]
    draw(found, picture_place("mass_felt.png"))
    publish("admittance", rows, _PACKAGES, {"masses": found, "faults": table})


if __name__ == "__main__":
    main()

"""Several random admittance displays with one account, in a loop of floats, judged by the sum of true energies."""

import math
from dataclasses import dataclass, replace
from random import Random
from typing import Any

from canhaptic.control.admittance import build_display_group
from canhaptic.control.admittance.group_environment import GroupCupAndBall, GroupEnvironment, GroupMass, PathMass
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.control.balance import Certificate
from canhaptic.control.mechanisms.five_bar import FiveBar
from canhaptic.control.mechanisms.kinematics import Kinematics, Limit
from canhaptic.control.mechanisms.planar_2r import Planar2R
from canhaptic.sim.plant.velocity_drive import VelocityDrivenPlant
from tools.displays.direct import Display, Outcome, watch
from tools.displays.judge import claims_of
from tools.displays.random_display import _STATIC, random_display

_PARTS = 4
"""Parts of a hold in which slew and acceleration are watched; a power of two."""


@dataclass(frozen=True)
class AdmittanceGroup:
    """The axes, each with a rig and a hand of its own, and what they render together."""

    axes: tuple[Display, ...]
    environment: GroupEnvironment
    parameters: GuardedAdmittanceParameters
    kinematics: Kinematics | None = None  # None: the axes are the coordinates of what is rendered


@dataclass
class GroupOutcome:
    """What one run came to; energies in [J]."""

    axes: list[Outcome]
    least: float = 0.0  # true sum through all sensors
    believed: float = 0.0
    overclaimed: float = 0.0  # believed above true, at most
    underclaimed: float = 0.0  # true above believed and resolution together, at most
    uncertified: int = 0
    by_hand: int = 0  # holds whose commands rest on a declared hand
    given_by_one: float = 0.0  # least true energy of one axis alone


_BY_HAND = (Certificate.LARGEST_HAND_FORCE.value, Certificate.DECLARED_HAND.value)
_NO_HAND = {"hand_stiffness": 0.0, "hand_speed": 0.0, "hand_damping": 0.0, "drive_friction": None, "drive_damping": 0.0}


def random_group(seed: int, size: int = 2) -> AdmittanceGroup:
    """Returns two displays or more that differ in rig, sensor and hand, with one account."""
    random, first = Random(seed), random_display(2 * seed, "guarded")
    known = first.parameters
    assert isinstance(known, GuardedAdmittanceParameters)
    if first.properties.sampling == "impulse":  # of one axis only
        first = _with_means(first)
    first = replace(first, properties=first.properties.model_copy(update={"jitter": 0.0}))
    others = [_beside(first, random_display(2 * seed + place, "guarded"), random) for place in range(1, size)]
    mass, damping = random.choice([0.2, 1.0, 4.0]), random.choice([0.0, 5.0])
    walls = {"lower": (-0.03, -1.0, -0.02)[:size], "upper": (1.0, 0.05, 0.02)[:size]}
    environment = GroupMass(mass=mass, damping=damping, **walls)
    if random.random() < 0.5:
        corners = tuple(corner[:size] for corner in ((-0.02, 0.0, 0.01), (0.02, 0.0, -0.02), (0.02, 0.03, 0.0)))
        environment = PathMass(mass=mass, damping=damping, points=corners, closed=random.random() < 0.5)
    if known.hand_stiffness:
        known = known.model_copy(update={
            "drive_friction": max(_STATIC if axis.effects else 0.0 for axis in (first, *others)),
            "drive_damping": max(axis.plant.damping for axis in (first, *others)),
        })  # fmt: skip
    return AdmittanceGroup((first, *others), environment, known)


def group_of_any_kind(seed: int) -> AdmittanceGroup:
    """Returns two axes, three, an arm of two links or a five-bar, in turn; every third with a spring or with balls."""
    kinds = (random_group, lambda one: random_group(one, 3), lambda one: on_an_arm(random_group(one)))
    group = (*kinds, lambda one: on_a_five_bar(random_group(one)))[seed % 4](seed)
    return with_spring_or_balls(group) if seed % 3 == 2 else group


def with_spring_or_balls(group: AdmittanceGroup) -> AdmittanceGroup:
    """Returns the group with a spring to ground, around where its handle begins, or with cups and balls."""
    random, given, of = Random(group.axes[0].seed + 1), group.environment, group.kinematics
    at = [axis.plant.initial_position for axis in group.axes]
    rest = [place + random.uniform(-0.02, 0.02) for place in (at if of is None else of.pose(at).position)]
    if random.random() < 0.5:
        spring = {"stiffness": random.choice([50.0, 500.0, 5000.0]), "rest": tuple(rest)}
        return replace(group, environment=given.model_copy(update=spring))
    cup, ball, length = random.choice([0.5, 2.4]), random.choice([0.2, 0.6]), random.choice([0.05, 0.45])
    shared = {key: getattr(given, key) for key in ("damping", "lower", "upper")}
    return replace(group, environment=GroupCupAndBall(cup=cup, ball=ball, length=length, **shared))


def _beside(first: Display, other: Display, random: Random) -> Display:
    """Returns a display with the loop and the timing that a group shares with its first one."""
    is_declared = bool(getattr(first.parameters, "hand_stiffness", 0.0))
    lightest = 0.9 if is_declared else 0.7  # with such a hand the mass has a lower bound
    plant = first.plant.model_copy(update={"mass": first.plant.mass * random.uniform(lightest, 1.0)})
    shared = {key: getattr(first.properties, key) for key in ("sample_time", "delay", "latency")}
    other = _with_means(other) if other.properties.sampling == "impulse" else other
    sensor = other.simulation.sensor.model_copy(update={"latency": first.properties.latency})
    return replace(
        other, plant=plant, commands_lost=first.commands_lost, samples_lost=first.samples_lost,
        simulation=first.simulation.model_copy(update={"sensor": sensor}),
        properties=other.properties.model_copy(update={**shared, "jitter": 0.0}),
    )  # fmt: skip


def on_an_arm(group: AdmittanceGroup) -> AdmittanceGroup:
    """Returns a group whose axes are the joints of an arm of two links [rad], around a pose that is not singular."""
    random = Random(group.axes[0].seed)
    arm = Planar2R(first=random.uniform(0.2, 0.5), second=random.uniform(0.2, 0.5))
    return _around(
        group, arm, (random.uniform(-3.0, 3.0), random.choice([-1.0, 1.0]) * random.uniform(0.6, 2.2)), random
    )


def on_a_five_bar(group: AdmittanceGroup) -> AdmittanceGroup:
    """Returns a group whose axes move a five-bar: any pose, elbows and handle on any side, near a singular one too."""
    random, pi = Random(group.axes[0].seed), math.pi
    linkage = FiveBar(
        base=random.uniform(0.0, 0.2), proximal=(random.uniform(0.1, 0.2), random.uniform(0.1, 0.2)),
        distal=(random.uniform(0.15, 0.3), random.uniform(0.15, 0.3)), assembly=random.choice(["up", "down"]),
        least_sine=random.choice([0.02, 0.1]),
    )  # fmt: skip
    while True:
        places = random.uniform(-pi, pi), random.uniform(-pi, pi)
        if linkage.pose(places).limit == Limit.NONE:
            return _around(group, linkage, places, random)


def _around(group: AdmittanceGroup, of: Kinematics, places: tuple[float, float], random: Random) -> AdmittanceGroup:
    """Returns a group on a mechanism, its hands around a pose, with walls near that or none."""
    axes = []
    for axis, place in zip(group.axes, places, strict=True):
        plant = axis.plant.model_copy(update={"initial_position": place})
        user = None if axis.user is None else axis.user.model_copy(update={"rest": place})
        axes.append(replace(axis, plant=plant, user=user))
    mass, damping = random.choice([1.0, 10.0, 50.0]), random.choice([0.0, 20.0])
    environment = GroupMass(mass=mass, damping=damping)
    if random.random() < 0.5:
        x, y = of.pose(places).position
        environment = GroupMass(mass=mass, damping=damping, lower=(x - 0.01, y - 1.0), upper=(x + 1.0, y + 0.01))
    known = group.parameters.model_copy(update=_NO_HAND)
    return replace(group, axes=tuple(axes), environment=environment, kinematics=of, parameters=known)


def _with_means(display: Display) -> Display:
    """Returns a display whose sensor shows means in place of a running impulse."""
    sensor = display.simulation.sensor.model_copy(update={"sampling": "mean"})
    return replace(
        display, simulation=display.simulation.model_copy(update={"sensor": sensor}),
        properties=display.properties.model_copy(update={"sampling": "mean"}),
    )  # fmt: skip


def run_group(group: AdmittanceGroup, cycles: int) -> GroupOutcome:
    """Returns what so many SYNCs came to."""
    axes, random = group.axes, Random(group.axes[0].seed)
    properties, period = [axis.properties for axis in axes], round(axes[0].properties.sample_time * 1e9)
    controller: Any = build_display_group(group.environment, "guarded", group.parameters, properties, group.kinematics)
    plants = [VelocityDrivenPlant(a.plant, a.simulation, a.user, a.effects, period, a.seed) for a in axes]
    found = GroupOutcome([Outcome() for _ in axes])
    queue, acting, rows = [[0.0] * len(axes) for _ in range(properties[0].delay)], [0.0] * len(axes), [0] * len(axes)
    for plant in plants:
        plant.begin(0)
    before = [(plant.force, plant.velocity, plant.position) for plant in plants]
    for k in range(cycles):
        if k:
            for place, command in enumerate(queue.pop(0)):
                if rows[place] < axes[place].commands_lost and random.random() < 0.3:
                    rows[place] += 1
                else:
                    rows[place], acting[place] = 0, command
            for place, plant in enumerate(plants):
                for part in range(1, _PARTS + 1):
                    plant.advance_to((k - 1) * period + part * period // _PARTS, acting[place])
                    before[place] = watch(found.axes[place], plant, before[place], period * 1e-9 / _PARTS)
        shown = [-plant.read_force() for plant in plants]
        counts = [p.encoder_count for p in properties]
        positions = [
            round(plant.encoder_position / c) * c if c else plant.encoder_position
            for plant, c in zip(plants, counts, strict=True)
        ]
        lost = k > 3 and random.random() < axes[0].samples_lost
        balance = controller.sample_lost() if lost else controller.step(positions, shown)
        queue.append(list(balance.torques))
        energies = [-plant.energy().motor for plant in plants]
        found.least, found.given_by_one = min(found.least, sum(energies)), min(found.given_by_one, *energies)
        found.believed += balance.account.h_i
        if properties[0].latency == 0 and not lost:
            found.overclaimed = max(found.overclaimed, found.believed - sum(energies))
            most = found.believed + controller.energy_resolution
            found.underclaimed = max(found.underclaimed, sum(energies) - most)
        found.uncertified += balance.account.certificate == Certificate.NONE.value
        found.by_hand += balance.account.certificate in _BY_HAND
    return found


def with_true_group_bounds(group: AdmittanceGroup, cycles: int) -> tuple[AdmittanceGroup, GroupOutcome] | None:
    """Returns a group whose declared slew and acceleration hold, with its run; None where none was found."""
    for _ in range(3):
        found = run_group(group, cycles)
        axes, is_true = [], True
        for axis, seen in zip(group.axes, found.axes, strict=True):
            declared = axis.properties
            is_true = is_true and seen.slew <= declared.force_slew and seen.acceleration <= declared.handle_acceleration
            bounds = {
                "force_slew": max(declared.force_slew, 1.5 * seen.slew),
                "handle_acceleration": max(declared.handle_acceleration, 1.5 * seen.acceleration),
            }
            axes.append(replace(axis, properties=declared.model_copy(update=bounds)))
        known, shown = group.parameters, max(axis.force for axis in found.axes)
        far = max(axis.far_speed for axis in found.axes)
        if known.largest_hand_force:
            is_true = is_true and shown <= known.largest_hand_force
            known = known.model_copy(update={"largest_hand_force": 1.5 * shown})
        if known.hand_stiffness:
            is_true = is_true and far <= known.hand_speed
            known = known.model_copy(update={"hand_speed": 1.5 * far})
        if is_true:
            return group, found
        group = replace(group, axes=tuple(axes), parameters=known)
    return None


def false_group_claims(group: AdmittanceGroup, found: GroupOutcome) -> list[str]:
    """Returns what the account of a group says and the plants deny; the declarations being true."""
    return claims_of(found, group.parameters.energy_allowance, promises=True)

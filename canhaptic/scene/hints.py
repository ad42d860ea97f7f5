"""Stability hints: limits of stiffness and damping from rate, delay and device, compared with the requested values.

For an admittance display they are the lightest mass felt and the energy of its faults; see
`canhaptic.control.admittance`.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from math import sqrt
from typing import Final, NamedTuple

from canhaptic.axis_units import effort_unit, mass_unit, stiffness_unit
from canhaptic.control.admittance.declared_hand import DeclaredHand, damping_border
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters, loop_settings
from canhaptic.control.certificates import scalar_bounds as bounds
from canhaptic.control.damping import largest_stable_damping, least_oscillating_damping
from canhaptic.control.ledger import DEFAULT_LIMIT
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.verdict import NO_PULL
from canhaptic.drive.profile.causality import IMPEDANCE
from canhaptic.meters import promise_of
from canhaptic.quantities import ACCOUNT, LIMITS
from canhaptic.scene.displays import display_properties
from canhaptic.scene.models import AxisScene, Port, Scene

_BY_DAMPING: Final = ("guarded", "energy_bounding")
"""Algorithms that certify torques by the declared damping of the device."""
LEAN: Final = 0.25
"""Force of a hand that leans on a wall, as a fraction of the torque limit."""
DRAG: Final = 0.1
"""Drag force that a hand hardly feels [N or N*m]."""


LARGEST_ADVISED: Final = 1e-3
"""Largest energy allowance that is proposed [J]: 0.25 kg at 9 cm/s."""
_ANY_TORQUE: Final = 1e9  # [N or N*m]
_STIFFNESS: Final = "environment.stiffness"


def advised_allowance(loop: LoopProperties, hand_force: float, losses: int = 0) -> float:
    """Return the energy allowance [J] with which a wall of half the certified stiffness engages at any approach speed.

    It is h F_h^2 / 4 with h = T^2 / m, three times that with a delay of one sample, at most `LARGEST_ADVISED`.

    Args:
        loop: Properties of the loop and the device; the result is 0 without the declarations for a hand force.
        hand_force: Declared force of the hand [N or N*m].
        losses: Consecutive lost cycles that the certificates survive.
    """
    if loop.moving_mass is None or loop.device_damping_bound is None:
        return 0.0
    pull, least, most = hand_force + (loop.device_friction_bound or 0.0), 0.0, loop.device_damping_bound
    response = bounds.displacement_response(loop.sample_time, loop.moving_mass, pull, least, most, timing=loop.timing)
    holds = loop.delay + losses
    energy = bounds.start_energy(response, holds, 0.5 * bounds.renderable_by_hand_force(response, holds, _ANY_TORQUE))
    return min(energy, LARGEST_ADVISED)


def allowance_words(energy: float, loop: LoopProperties, unit: str) -> str:
    """Return in words what an energy allowance [J] permits, for an axis in m or rad."""
    mass = loop.moving_mass or 1.0
    moving = f"{mass:.2g} {mass_unit(unit)} at {sqrt(2.0 * energy / mass):.2g} {unit}/s"
    return f"the handle may give out this much more than it received since the start: {moving}"


class Hint(NamedTuple):
    """One limit of an axis."""

    axis: str
    quantity: str  # its name in `LIMITS`
    what: str  # the same for a reader
    limit: float | None  # None when it is not known
    requested: float | None  # by the scene; None where there is nothing to compare
    unit: str  # of both
    text: str  # source of the limit, or the declaration that is missing
    concerns: bool = True  # False: a limit of a plain wall, on which the chosen algorithm does not depend
    certificate: str = ""  # that limits this stiffness: "device damping", "hand force", "hand speed" or "largest"
    is_of_encoder: bool = False  # whether dry friction keeps this stiffness passive with the encoder

    @property
    def exceeded(self) -> bool:
        """Whether the scene requests more than the limit."""
        return self.limit is not None and self.requested is not None and self.requested > self.limit


def _limit(
    axis: AxisScene, quantity: str, limit: float | None, text: str, *details: str, certificate: str = "",
    concerns: bool = True,
) -> Hint:  # fmt: skip
    """Return a limit of an axis: its title, its unit and the value to compare with are those of `LIMITS`."""
    of, given = LIMITS[quantity], axis.parameters
    what, unit = of.title.format(*details), of.unit_on(given.unit)
    return Hint(given.name, quantity, what, limit, _requested(axis, of.key), unit, text, concerns, certificate)


def _plain(axis: AxisScene, quantity: str, limit: float | None, text: str, *details: str) -> Hint:
    """Return a limit that holds for a spring and damper without any algorithm."""
    concerns = axis.passivity.name == "unprotected"
    text = text if concerns else f"plain wall, no algorithm: {text}"
    return _limit(axis, quantity, limit, text, *details, concerns=concerns)


def _requested(axis: AxisScene, key: str) -> float | None:
    """Return the value of a key of the scene; None where the axis has no such number, or there is no key."""
    section, _, name = key.partition(".")
    owner = axis.loop if section == "passivity" else axis.environment.parameters
    value = getattr(owner, name, getattr(owner, "steepest", None) if name == "stiffness" else None)  # that of a sum
    return float(value) if isinstance(value, int | float) else None


def hints_of(scene: Scene) -> list[Hint]:
    """Return the limits of all axes of a scene."""
    of_ports = [hint for port in scene.ports for hint in port_hints(port, scene)]
    return of_ports + later_hints(scene) + stop_hints(scene)


def port_hints(port: Port, scene: Scene) -> list[Hint]:
    """Return the limits of the axes of a port; they are information only, its algorithm enforces passivity."""
    if port.causality is not IMPEDANCE:
        return [hint for axis in port.axes for hint in _of_motion(axis, port, scene)]
    return [hint for axis in port.axes for hint in _of_torque(axis, port)]


def stop_hints(scene: Scene) -> list[Hint]:
    """Return the most that a stop can give out on each axis with a torque, and brakes that hold nothing meanwhile."""
    hints = []
    for axis in scene.axes:
        loop, brake = axis.loop, axis.parameters.brake
        if not axis.parameters.causality.holds:
            time = (1 + loop.delay) * loop.sample_time * (1.0 + (loop.sync_jitter or 0.0)) + (loop.torque_window or 0.0)
            most = axis.parameters.torque_limit * time
            at_rest = None if loop.moving_mass is None else 0.5 * most * most / loop.moving_mass
            speed = f"{axis.parameters.unit}/s"
            text = (
                f"torque_limit acts for {time * 1e3:.3g} ms on a handle let go at rest; {most:.3g} J more per {speed}"
            )
            text += "" if loop.moving_mass is not None else "; moving_mass is not declared"
            is_large = at_rest is not None and at_rest > DEFAULT_LIMIT
            hints.append(_limit(axis, "stop_energy", at_rest, text, concerns=is_large))
        if brake is not None and not brake.holds_weight:
            text = f"declare brake.holds_weight: a stop holds nothing for set_time ({brake.set_time:g} s)"
            hints.append(_limit(axis, "stop_weight", None, text))
    return hints


def stability_hints(axis: AxisScene) -> list[Hint]:
    """Return the limits of a torque axis that renders alone."""
    return _of_torque(axis, axis.as_port())


def _of_torque(axis: AxisScene, port: Port) -> list[Hint]:
    """Return the limits of an axis by the certificates of its port, in motor coordinates.

    The stiffness of a network is in task space, which is that of the motors only with `identity` kinematics.
    """
    if not axis.is_read:
        text = "not known: environment or algorithm is own code, which is not run here"
        return [_limit(axis, "not_read", None, text)]
    rendered = port.rendered if port.kinematics.name == "identity" else axis.environment
    axis = replace(axis, passivity=port.passivity, environment=rendered)
    if len(port.axes) > 1:
        return [*_certificate_hints(axis, port.axes), *_apart_hint(axis, len(port.axes)), *_damping_hints(axis)]
    of_wall = [*_stiffness_hints(axis), _quantisation_hint(axis), *_damping_hints(axis)]
    return [*of_wall, *_certificate_hints(axis), *_encoder_hint(axis)]


def later_hints(scene: Scene) -> list[Hint]:
    """Return the limits of axes whose user code runs in a separate process, with its additional hold of delay."""
    if (scene.run.code_runs_in or ("cycle" if scene.simulated else "process")) == "cycle":
        return []
    hints = []
    for axis in scene.axes:
        if axis.is_read and not axis.is_own:
            continue
        later = replace(axis, loop=axis.loop.model_copy(update={"delay": axis.loop.delay + 1}))
        for now, hint in zip(_certificate_hints(axis), _certificate_hints(later), strict=True):
            if hint.certificate:
                text = f"own code in a process of its own, one hold later (code_runs_in: cycle: {now.limit:.4g})"
                hints.append(hint._replace(what=f"{hint.what}, one hold later", text=text, certificate=""))
    return hints


def _losses(axis: AxisScene) -> int:
    """Return the consecutive cycles without a new torque that the certificates survive."""
    return int(getattr(axis.passivity.parameters, "max_consecutive_losses", 0))


def _apart_hint(axis: AxisScene, axes: int) -> list[Hint]:
    """Return the cost of certifying each axis separately while several move together.

    For torques f and -f on two axes that both move by D = v T in a hold, the energy f D generated by one counts in all
    H holds, and the energy absorbed by the other in none: H f D <= f^2 / 2k needs an extension f / k >= 2 H T v.
    """
    losses, unit = _losses(axis), axis.parameters.unit
    if axes == 1 or not losses:
        return []
    holds = 1 + axis.loop.delay + losses
    text = (
        f"at a speed of 1 {unit}/s, and in proportion; max_consecutive_losses {losses}: each axis is certified by "
        f"itself, for {holds} holds. With max_consecutive_losses 0 a spring between axes pulls at once"
    )
    limit = 2.0 * holds * axis.loop.sample_time
    return [_limit(axis, "coupling_stretch", limit, text)]


def _known(axis: AxisScene, key: str, of_plant: str) -> tuple[float | None, str]:
    """Return a property of the device, declared or of the simulated plant, and its source."""
    declared = getattr(axis.loop, key)
    if declared is not None:
        return float(declared), f"with the declared {key}"
    if axis.simulation is not None:
        return float(getattr(axis.simulation.plant, of_plant)), f"with the {of_plant} of the simulated plant"
    return None, f"unknown: declare passivity.{key}"


def _stiffness_hints(axis: AxisScene) -> list[Hint]:
    damping, source = _known(axis, "device_damping", "damping")
    period, delay = axis.loop.sample_time, axis.loop.delay
    bound = None if damping is None else bounds.renderable_by_device_damping(damping, period, 0)
    hints = [_plain(axis, "stiffness_colgate", bound, f"passive below this, {source}")]
    if delay and damping is not None:
        bound = bounds.renderable_by_device_damping(damping, period, delay)
        text, holds = f"held by the device's damping, {source}", f"{1 + delay}"
        hints.append(_plain(axis, "stiffness_delayed", bound, text, f"{delay}", holds))
    return hints


def _quantisation_hint(axis: AxisScene) -> Hint:
    """Bound 2 f_c / count: the Coulomb friction f_c must cover the force error of half a count, k count / 2.

    Abbott and Okamura, "Effects of position quantization and sampling rate on virtual-wall passivity", IEEE Trans.
    Robotics 21, 2005: a plain spring wall is passive for every user up to the lesser of this and Colgate's bound.
    """
    stiffness, friction = _requested(axis, _STIFFNESS), _simulated_friction(axis)
    unit = effort_unit(axis.parameters.unit)
    text = "no Coulomb friction known"
    if friction is not None:
        text = f"the simulated plant has {f'{friction:.3g} {unit} of' if friction else 'no'} Coulomb friction"
    if stiffness is not None:
        needed = 0.5 * stiffness * axis.loop.encoder_count
        text += f"; the requested wall needs {needed:.3g} {unit}"
    return _plain(axis, "stiffness_quantisation", quantisation_bound(axis), text)


def quantisation_bound(axis: AxisScene) -> float | None:
    """Return 2 f_c / count [N/m or N*m/rad]; None where no Coulomb friction is known, inf for an ideal encoder."""
    count, friction = axis.loop.encoder_count, _simulated_friction(axis)
    if friction is None:
        return None
    return 2.0 * friction / count if count else math.inf


def _simulated_friction(axis: AxisScene) -> float | None:
    """Return the least Coulomb friction that the simulated plant has in motion [N or N*m]; None when unknown."""
    if axis.simulation is None:
        return None
    frictions = [getattr(effect.parameters, "kinetic", None) for effect in axis.simulation.effects]
    return sum(float(friction) for friction in frictions if friction is not None)


def _damping_hints(axis: AxisScene) -> list[Hint]:
    """Return limits of damping; the first is from Colgate's condition b > k T / 2 + |d| at the requested stiffness."""
    hints, (device, source), stiffness = [], _known(axis, "device_damping", "damping"), _requested(axis, _STIFFNESS)
    period, delay = axis.loop.sample_time, axis.loop.delay
    if device is not None and stiffness is not None:
        limit = max(0.0, device - 0.5 * stiffness * period)
        hints.append(_plain(axis, "damping_colgate", limit, source))
    mass, source = _known(axis, "moving_mass", "mass")
    ripples = None if mass is None else least_oscillating_damping(delay, mass, period)
    diverges = None if mass is None else largest_stable_damping(delay, mass, period)
    text = f"the most that algorithms inject at delay {delay}, {source}"
    hints.append(_limit(axis, "damping_calm", ripples, text))
    return [*hints, _limit(axis, "damping_stable", diverges, f"at delay {delay}, {source}")]


def _certificate_hints(axis: AxisScene, together: Sequence[AxisScene] = ()) -> list[Hint]:
    """Return the stiffness that each declared certificate of `guarded` permits at the torque limit.

    A certificate covers a torque for the hold in which it acts, the holds of the delay, and those of lost frames
    (`max_consecutive_losses`). In a group the hand pulls on every axis at once, with the same force.
    """
    parameters, loop = axis.passivity.parameters, axis.loop
    torque, losses, hints = axis.parameters.torque_limit, _losses(axis), []
    lag = loop.delay + losses
    held: dict[str, tuple[float, str]] = {}
    more = f"; max_consecutive_losses {losses}: {lag + 1} holds" if losses else ""
    hand_force, hand_speed = getattr(parameters, "hand_force", None), getattr(parameters, "hand_speed", None)
    if hand_force is not None and loop.moving_mass is not None:
        least, most = 0.0 if len(together) > 1 else loop.device_damping or 0.0, loop.device_damping_bound or 0.0
        pull = (hand_force + (loop.device_friction_bound or 0.0)) * _on_all(axis, together)
        given = loop.sample_time, loop.moving_mass, pull, least, most
        response = bounds.displacement_response(*given, timing=loop.timing)
        of_each = f" on each of {len(together)} axes" if len(together) > 1 else ""
        hand = f"hand force up to {hand_force:g}" if hand_force else "assumes that the hand never pulls"
        text = f"{hand}{of_each if hand_force else ''}{more}"
        held["hand force"] = bounds.renderable_by_hand_force(response, lag, torque), f"at the torque limit, {text}"
        hints += _felt_hints(axis, response, lag, text)
    if loop.device_damping and axis.passivity.name in _BY_DAMPING:
        limit = bounds.renderable_by_device_damping(loop.device_damping, loop.sample_time, lag)
        held["device damping"] = limit, f"for every user, device_damping {loop.device_damping:g} declared{more}"
    if hand_speed is not None:
        limit = bounds.renderable_by_hand_speed(hand_speed, loop.sample_time, lag, torque)
        held["hand speed"] = limit, f"at the torque limit, hand speed up to {hand_speed:g}{more}"
    return [*_held_stiffness(axis, held), *hints]


def _encoder_hint(axis: AxisScene) -> list[Hint]:
    """Return the stiffness f_c / count that `guarded` renders indefinitely with this encoder."""
    count, friction, asked = axis.loop.encoder_count, axis.loop.device_friction or 0.0, _requested(axis, _STIFFNESS)
    if not count or axis.passivity.name != "guarded":
        return []
    unit, limit = axis.parameters.unit, friction / count if friction else None
    if friction:
        text = "at any speed of any hand, by device_friction; twice that for tremor over one count"
        if asked:
            text += f"; counts up to {friction / asked:.2g} {unit} keep the requested wall, here {count:.2g} {unit}"
    else:
        uncertain = f"{asked * count * count:.2g} J" if asked else "energy"
        keeps = f"{asked * count:.2g} {effort_unit(unit)} of dry friction keeps" if asked else "Dry friction keeps"
        text = f"each press of one count and back costs the account {uncertain}, so repeated presses soften the wall. "
        text += f"{keeps} the wall stiff: measure it (canhaptic commission) and declare passivity.device_friction"
    return [_limit(axis, "stiffness_pressed", limit, text)._replace(is_of_encoder=True)]


def guarantee(axis: AxisScene, hints: Sequence[Hint]) -> str:
    """Return in words on which declaration the certified stiffness of an axis rests.

    Args:
        axis: Axis of the scene.
        hints: Hints of the scene.
    """
    own = [hint for hint in hints if hint.axis == axis.parameters.name and hint.certificate not in ("", "largest")]
    held = [(hint.limit, hint.certificate) for hint in own if hint.limit is not None]
    if not held:
        return ""
    unit, (most, declared) = stiffness_unit(axis.parameters.unit), max(held)
    if declared == "hand force" and promise_of(axis.passivity.parameters).hand_force == 0.0:
        declared = NO_PULL
    text = f"{ACCOUNT['certificates'].title}: {declared}; walls up to {most:.3g} {unit} at the torque limit"
    bound = axis.loop.device_damping_bound
    if bound and axis.loop.device_damping is None:
        limit = bounds.renderable_by_device_damping(bound, axis.loop.sample_time, axis.loop.delay + _losses(axis))
        text += f"; for a hand that also pulls: walls up to {limit:.3g} {unit}, once device_damping is measured"
    return text


def _felt_hints(axis: AxisScene, response: bounds.DisplacementResponse, lag: int, text: str) -> list[Hint]:
    """Return how much of a wall a hand feels that leans on it or approaches slowly, by the hand-force certificate."""
    push, stiffness = LEAN * axis.parameters.torque_limit, _requested(axis, _STIFFNESS)
    limit = bounds.renderable_by_hand_force(response, lag, push)
    pushed = f"{push:.3g} {effort_unit(axis.parameters.unit)}"
    slowest = bounds.start_speed(response, axis.loop.sample_time, lag, axis.loop.encoder_count)
    begins = "if no energy is stored; a slower hand feels the wall deeper in it, or not at all"
    if friction := axis.loop.device_friction:
        slowest, begins = 0.0, f"up to device_friction {friction:g} at once, more with the energy below"
    return [
        _limit(axis, "stiffness_held", limit, f"{text}{_share(limit, stiffness)}", pushed),
        _limit(axis, "approach_speed", slowest, f"{begins}; {text}", concerns=False),
        *_energy_hint(axis, response, lag, min(stiffness or limit, limit)),
    ]


def _energy_hint(axis: AxisScene, response: bounds.DisplacementResponse, lag: int, stiffness: float) -> list[Hint]:
    """Return the energy needed to feel a contact at any speed; no hint if none is needed."""
    energy, unit = bounds.start_energy(response, lag, stiffness), axis.parameters.unit
    parameters = axis.passivity.parameters
    if energy in {0.0, math.inf}:
        return []
    wall = f"{stiffness:.4g} {stiffness_unit(unit)}"
    drag, friction = getattr(parameters, "drag", 0.0) or DRAG, axis.loop.device_friction or 0.0
    earning = f"{drag:g} {effort_unit(unit)} of drag earn it over {energy / drag:.2g} {unit} of faster motion"
    if friction:
        earning = f"device_friction earns it over {energy / friction:.2g} {unit} of any motion"
    kept = getattr(parameters, "earned_energy", None)
    if kept is not None and kept < energy:
        earning += f"; earned_energy keeps {kept:.2g} J of it"
    return [_limit(axis, "contact_energy", energy, f"{earning}; or set energy_allowance to it", wall)]


def _on_all(axis: AxisScene, together: Sequence[AxisScene]) -> float:
    """Return the motion of an axis by a hand on all axes over that by a hand on it alone: sqrt(sum(1 / m_j) m_i)."""
    masses = [each.loop.moving_mass for each in together]
    if axis.loop.moving_mass is None or None in masses or len(masses) < 2:
        return 1.0
    return math.sqrt(sum(axis.loop.moving_mass / mass for mass in masses if mass is not None))


def _held_stiffness(axis: AxisScene, held: dict[str, tuple[float, str]]) -> list[Hint]:
    """Return one hint per certificate, and one for the largest of several, which is the effective limit."""
    stiffness = _requested(axis, _STIFFNESS)
    hints = [
        _limit(
            axis, "stiffness_certified", limit, f"{text}{_share(limit, stiffness)}", f" by {name}",
            certificate=name, concerns=len(held) == 1,
        )
        for name, (limit, text) in held.items()
    ]  # fmt: skip
    if len(held) > 1:
        name = max(held, key=lambda entry: held[entry][0])
        limit = held[name][0]
        text = f"the largest limit applies: by {name}{_share(limit, stiffness)}"
        hints.append(_limit(axis, "stiffness_certified", limit, text, "", certificate="largest"))
    return hints


def _share(limit: float, asked: float | None) -> str:
    if not asked:
        return ""
    return f"; covers {100.0 * min(1.0, limit / asked):.3g} % of the requested stiffness"


def _of_motion(axis: AxisScene, port: Port, scene: Scene) -> list[Hint]:
    properties = display_properties(axis)
    text = "costs the account as much as dry friction of this size: sensor error, and what point samples leave unseen"
    hints = [_limit(axis, "force_uncertainty", _uncertainty(properties), text)]
    known, rendered = port.passivity.parameters, port.rendered.parameters
    if isinstance(known, GuardedAdmittanceParameters):
        asked = getattr(rendered, "inertia", getattr(rendered, "mass", None))
        if port.kinematics.name != "identity":
            asked = None  # in task space, which is not that of the axis
        hints += [*_of_guard(axis, known, properties, asked), *_of_faults(axis, known, properties, scene)]
    return hints


def _uncertainty(properties: AdmittanceProperties) -> float:
    """Return the uncertainty of the force in the account [N or N*m]."""
    time = properties.longest_hold
    sloped = min(0.25 * properties.force_slew * time, properties.force_bend * time * time / 12.0)
    return properties.force_error + (0.0 if properties.is_mean else sloped)


_SPEEDING_UP: Final = (
    "from the start to a steady speed v the hand puts in m v^2 / 2 less energy_allowance; later moves use energy left "
    "from earlier ones, so the mass that `run` gives is that of the whole run and may be as light as requested"
)
_WITHOUT_GUARD: Final = (
    "M + c tau; the guard still acts in short or slow motion, if the account is more uncertain than the damper loses"
)


_NOTHING_STORED: Final = "by energy_allowance, with nothing stored"


def _of_guard(
    axis: AxisScene, known: GuardedAdmittanceParameters, properties: AdmittanceProperties, asked: float | None
) -> list[Hint]:
    unit = mass_unit(axis.parameters.unit)
    time, gain, mass = properties.longest_hold, known.loop_gain, known.drive_mass
    holds = properties.delay + 1 + known.max_consecutive_losses
    lag = lag_of(properties)
    felt = mass + 0.5 * holds * time * gain
    never = mass + gain * lag
    start = sqrt(4.0 * known.energy_allowance / (gain * time * holds))
    about = "" if asked is None else f"; requested {asked:g} {unit}"
    over_a_run = () if asked is None else run_mass(asked, never)
    promised = dict(zip(("run_mass_least", "run_mass_most"), over_a_run, strict=False))
    hints = [
        _limit(axis, "first_mass", felt, f"{_SPEEDING_UP}{about}"),
        *(_limit(axis, name, mass, f"{_OF_RANDOM}{about}") for name, mass in promised.items()),
        _limit(axis, "unguarded_mass", never, f"{_WITHOUT_GUARD}{about}"),
        _limit(axis, "first_speed", start, _NOTHING_STORED),
    ]
    if known.integral_gain:
        text = "in mode 8 the drive's integral is unknown: nothing is certified if holds differ in length"
        hints.append(_limit(axis, "jitter_allowed", 0.0, text))
    elif known.hand_stiffness:
        hand = DeclaredHand(known, loop_settings(known, properties), properties)
        carried = hand.lightest(properties.speed_limit)
        text = "at speed_limit, with a hand as declared (hand_stiffness); heavier at lower speed" + about
        hints.append(_limit(axis, "carried_mass", carried, text))
        if asked is not None and asked < never:
            border = damping_border(mass, gain, asked, known.hand_stiffness, lag)
            text = f"in place of that mass, for the declared hand_stiffness; requested {asked:g} {unit}"
            hints.append(_limit(axis, "unguarded_damping", border, text))
    if asked is not None and properties.speed_quantum:
        least = asked * properties.speed_quantum / properties.sample_time
        text = "mass times the smallest step of the speed, over T; in mode 8 a step is one count per T"
        text += ": use a fine encoder"
        hints.append(_limit(axis, "least_force", least, text))
    return hints


_OVER_A_RUN: Final = 0.745, 1.115
"""Least and largest mass over the expected one, within which 19 of 20 random displays are felt over a run."""
_OF_RANDOM: Final = "as 19 of 20 random displays moved to and fro at 0.5 to 4 Hz for 2 s"
_LIGHTER: Final = 0.33
"""Exponent for the mass that is felt: it is the requested mass times ((M + c tau) / requested mass) to this power."""


def run_mass(asked: float, never: float) -> tuple[float, float]:
    """Return the range of the mass that hands feel over a run, as found on random displays (`tools/displays/mass.py`).

    Args:
        asked: Mass requested [kg or kg*m^2].
        never: Lightest mass that is passive without a guard [kg or kg*m^2].
    """
    expected = asked * max(1.0, never / asked) ** _LIGHTER
    return _OVER_A_RUN[0] * expected, _OVER_A_RUN[1] * expected


def lag_of(properties: AdmittanceProperties) -> float:
    """Return the time from a force to the motion that it commands [s]."""
    return (properties.delay + 0.5 + properties.latency) * properties.longest_hold + properties.lag


def _of_faults(
    axis: AxisScene, known: GuardedAdmittanceParameters, properties: AdmittanceProperties, scene: Scene
) -> list[Hint]:
    """Return the energy generated by a sensor offset, a stalled master and a frozen sensor until each is detected."""
    given, mode, speed = axis.parameters, axis.parameters.causality, properties.speed_limit
    room = mode.ends[1] - mode.ends[0] if len(mode.ends) > 1 else None
    offset = "at most the offset times the distance between the position limits"
    if known.drive_friction is None:
        offset += "; found by commission only"
    else:
        least = 2.0 * (known.drive_friction + _uncertainty(properties))
        offset += f"; noticed from about {least:.3g} {effort_unit(given.unit)} on"
    power = min(0.25 * known.loop_gain * speed * speed, given.torque_limit * speed)
    silence, energy = scene.bus.master_silence_ns * 1e-9, None
    frozen = "never noticed (admittance.force.frozen_after)"
    if (noticed := mode.force.frozen_after) is not None:
        energy = power * noticed * properties.longest_hold
        frozen = f"{power:.3g} W until it is noticed after {noticed * properties.longest_hold:.4g} s"
    stalled = f"{power:.3g} W at speed_limit for {silence:g} s"
    return [
        _limit(axis, "offset_energy", room, offset),
        _limit(axis, "stalled_energy", power * silence, stalled),
        _limit(axis, "frozen_energy", energy, frozen),
    ]

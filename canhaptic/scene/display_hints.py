"""Figures of an admittance display to know before the first touch; see `canhaptic.control.admittance`."""

from math import pi, sqrt

from canhaptic.axis_units import damping_unit, effort_unit
from canhaptic.control.admittance.damping_border import damping_border
from canhaptic.control.admittance.declared_hand import declared_hand_settings, lightest
from canhaptic.control.admittance.loop_parameters import GuardedDisplayParameters, loop_settings
from canhaptic.control.admittance.port import port_settings
from canhaptic.control.admittance.properties import DisplayProperties
from canhaptic.scene.hints import Hint
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import display_properties


def display_hints(scene: Scene) -> list[Hint]:
    """Figures of every admittance display of a scene; none of them is enforced here."""
    return [hint for axis in scene.axes if axis.parameters.admittance is not None for hint in _of_axis(axis, scene)]


def _of_axis(axis: AxisScene, scene: Scene) -> list[Hint]:
    given, properties = axis.parameters, display_properties(axis)
    name, effort, speed_unit = given.name, effort_unit(given.unit), f"{given.unit}/s"
    time = properties.longest_hold
    doubt = properties.force_error + (0.0 if properties.sampling != "point" else 0.25 * properties.force_slew * time)
    text = "acts on the account like dry friction of this size; slew T / 4 for point samples, and the error of a value"
    hints = [Hint(name, "force uncertainty of the account", doubt, None, effort, text)]
    group = next((group for group in scene.groups if group.name == axis.group), None)
    chosen = (axis.passivity, axis.environment) if group is None else (group.passivity, group.network)
    known, rendered = (part.parameters for part in chosen)
    if isinstance(known, GuardedDisplayParameters):
        asked = getattr(rendered, "inertia", getattr(rendered, "mass", None))
        if group is not None and group.kinematics.name != "identity":
            asked = None  # in task space, which is not that of the axis
        hints += _of_guard(axis, known, speed_unit, asked)
        hints += _of_faults(axis, known, scene)
    return hints


def _of_guard(axis: AxisScene, known: GuardedDisplayParameters, speed_unit: str, asked: float | None) -> list[Hint]:
    properties, name = display_properties(axis), axis.parameters.name
    axis_unit = axis.parameters.unit
    unit, effort = "kg" if axis_unit == "m" else "kg*m^2", effort_unit(axis_unit)
    time, gain, mass = properties.longest_hold, known.loop_gain, known.drive_mass
    holds = properties.delay + 1 + known.max_consecutive_losses
    lag = (properties.delay + 0.5 + properties.latency) * time
    lag += 1.0 / (2.0 * pi * properties.filter) if properties.filter else 0.0
    felt = mass + 0.5 * (holds + properties.latency) * time * gain
    never = mass + gain * lag
    start = sqrt(4.0 * known.energy_allowance / (gain * time * holds))
    about = "" if asked is None else f"; asked {asked:g} {unit}"
    hints = [
        Hint(name, "mass felt, at least", felt, None, unit, f"while the guard acts, for every hand{about}"),
        Hint(name, "mass from which the guard never acts", never, None, unit, "passive without it: M + c tau" + about),
        Hint(name, "speed at which motion starts", start, None, speed_unit, "by energy_allowance, with nothing stored"),
    ]
    if known.integral_gain:
        text = (
            "of a drive with an integral (mode 8) nothing is certified where holds are uneven: what fills it is unknown"
        )
        hints.append(Hint(name, "SYNC jitter of a certificate", 0.0, properties.jitter, "", text))
    elif known.hand_stiffness:
        loop = loop_settings(known, properties)
        carried = lightest(declared_hand_settings(known, loop, properties.latency), loop, properties.speed_limit)
        text = "at speed_limit, with a hand as declared (hand_stiffness); heavier at less" + about
        hints.append(Hint(name, "mass carried for the declared hand", carried, None, unit, text))
        if asked is not None and asked < never:
            border = damping_border(mass, gain, asked, known.hand_stiffness, lag)
            text = f"in place of that mass, for the declared hand_stiffness; {asked:g} {unit} asked"
            hints.append(Hint(name, "damping from which it never acts", border, None, damping_unit(axis_unit), text))
    if asked is not None and properties.speed_quantum:
        least = asked * properties.speed_quantum / properties.sample_time
        text = (
            "mass times the smallest step of the speed, over T; in mode 8 a step is one count per T: use a fine encoder"
        )
        hints.append(Hint(name, "least force that moves it", least, None, effort, text))
    return hints


def _of_faults(axis: AxisScene, known: GuardedDisplayParameters, scene: Scene) -> list[Hint]:
    """Energy given out by a stalled master and by a frozen sensor, until each is detected."""
    properties, name = display_properties(axis), axis.parameters.name
    display, speed = axis.parameters.admittance, properties.speed_limit
    power = min(0.25 * known.loop_gain * speed * speed, axis.parameters.torque_limit * speed)
    silence = scene.bus.master_silence_ns * 1e-9
    noticed = None if display is None or display.force.frozen_after is None else display.force.frozen_after
    found = "never noticed (admittance.force.frozen_after)"
    energy = None
    if noticed is not None:
        energy = power * noticed * properties.longest_hold
        found = f"{power:.3g} W until it is noticed after {noticed * properties.longest_hold:.4g} s"
    return [
        _of_offset(axis, known, properties),
        Hint(name, "stalled master", power * silence, None, "J", f"{power:.3g} W at speed_limit for {silence:g} s"),
        Hint(name, "frozen sensor", energy, None, "J", found),
    ]


def _of_offset(axis: AxisScene, known: GuardedDisplayParameters, properties: DisplayProperties) -> Hint:
    """Largest energy given out for a sensor offset of one newton: the work of a constant force."""
    low, high = (getattr(axis.parameters.admittance, key, None) for key in ("position_low", "position_high"))
    room = None if low is None or high is None else high - low
    unit = "J/N" if axis.parameters.unit == "m" else "J/(N*m)"
    text = "an offset times the room between the limits of the position, never more"
    if known.drive_friction is None:
        text += "; found by commission only"
        return Hint(axis.parameters.name, "sensor with an offset", room, None, unit, text)
    port, effort = port_settings(properties), effort_unit(axis.parameters.unit)
    found = 2.0 * (
        known.drive_friction + port.error + (0.0 if port.is_mean else 0.25 * port.slew * properties.longest_hold)
    )
    text += f"; noticed from about {found:.3g} {effort} on"
    return Hint(axis.parameters.name, "sensor with an offset", room, None, unit, text)

"""Admittance displays of a scene: their declared properties, groups, and checks that need more than one section.

Only a scene with an admittance display loads this module.
"""

from collections.abc import Iterator
from math import pi
from typing import TYPE_CHECKING, Any, cast

from canhaptic.control.admittance import build_display_controller, build_display_group
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.motion_checks import MassAsked, MassFelt
from canhaptic.errors import ParameterError
from canhaptic.scene.buses import BusParameters
from canhaptic.scene.models import AxisScene, Port

if TYPE_CHECKING:
    from canhaptic.control.mechanisms.kinematics import Kinematics


def display_properties(axis: AxisScene) -> AdmittanceProperties:
    """Return the declared properties of an admittance display.

    Raises:
        ParameterError: A limit that every admittance display needs is missing, or the axis is no admittance display.
    """
    given, display = axis.parameters, axis.parameters.admittance
    if display is None:
        raise ParameterError(f"{given.name}: has no `admittance`; expected an admittance display")
    speed, rise = given.speed_limit if "speed_limit" in given.model_fields_set else None, display.acceleration_limit
    if speed is None or rise is None:
        needed = {"admittance.acceleration_limit": rise, "speed_limit": speed}
        missing = ", ".join(key for key, value in needed.items() if value is None)
        raise ParameterError(f"{given.name}: {missing}: missing; every admittance display needs it, add it")
    force, time = display.force, axis.loop.sample_time
    bend = {"force_bend": 2.0 * pi * force.corner * force.slew} if force.corner else {}
    counts = given.counts_per_unit
    room = {key: getattr(display, key) for key in ("position_low", "position_high")}
    return AdmittanceProperties(
        sample_time=time, jitter=axis.loop.sync_jitter or 0.0,
        delay=axis.loop.delay, sampling=force.sampling, latency=force.latency, filter=force.filter,
        force_slew=force.slew, handle_acceleration=display.handle_acceleration, force_error=force.error,
        encoder_count=1.0 / counts, speed_quantum=display.command_quantum(counts, time), speed_limit=speed,
        acceleration_limit=rise, torque_limit=given.torque_limit, **bend,
        **{key: limit for key, limit in room.items() if limit is not None},
    )  # fmt: skip


def display_controller(port: Port) -> Any:
    """Return the controller of a port of admittance displays, at rest; raise ParameterError."""
    here, by, properties = port.rendered.parameters, port.passivity, [display_properties(axis) for axis in port.axes]
    if not port.section:
        return build_display_controller(here, by.name, by.parameters, properties[0])
    kinematics = cast("Kinematics", port.kinematics.parameters)
    return build_display_group(here, by.name, by.parameters, properties, kinematics)


def mass_felt(axis: AxisScene, port: Port) -> MassFelt | None:
    """Return the estimator of the mass felt on an axis; None if its port renders no mass along it."""
    if port.rendered.name != "virtual_mass" or port.kinematics.name != "identity":
        return None
    environment: Any = cast("Any", port.rendered.parameters).of_axis(port.axes.index(axis))
    known = display_properties(axis)
    low, high = max(environment.lower_wall, known.position_low), min(environment.upper_wall, known.position_high)
    times = {"sample_time": known.sample_time, "count": known.encoder_count}
    return MassFelt(MassAsked(environment.mass, environment.stiffness, low=low, high=high, **times))


def display_faults(axis: AxisScene, bus: BusParameters, *, is_real: bool) -> Iterator[tuple[str, str]]:
    """Yield key and text of each fault of an admittance display, or of an axis that is only simulated as one."""
    given, display, simulation = axis.parameters, axis.parameters.admittance, axis.simulation
    if display is None:
        yield "", "simulation.admittance: got one, but the axis has no `admittance`; add it there"
        return
    got = "got an admittance display"
    if axis.simulated_drive is not None:
        yield "admittance", f"{got}, but this axis moves a simulated mechanism; expected a plant of its own"
    if bus.rpdo == "event":
        yield "admittance", f"{got} with rpdo: event, whose commands act at an unknown time; use synchronous"
    if simulation is not None and simulation.admittance is None:
        yield "admittance", f"{got}, but simulation.admittance is missing; add loop, grip and sensor"
    needed = {
        "admittance.position_low": display.position_low,
        "admittance.position_high": display.position_high,
        "admittance.acceleration_limit": display.acceleration_limit,
        "admittance.force.frozen_after": display.force.frozen_after,
        "speed_limit": given.speed_limit if "speed_limit" in given.model_fields_set else None,
        "watchdog: true": given.watchdog or None,
    }
    if missing := ", ".join(key for key, value in needed.items() if value is None and is_real):
        text = "an admittance display on a real interface does not move without, add it"
        yield "admittance", f"{missing}: missing; {text}"

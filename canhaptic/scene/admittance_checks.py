"""Checks of admittance displays that need more than one section of a scene."""

from canhaptic.drive.axis_parameters import AxisParameters
from canhaptic.drive.profile.admittance_parameters import AdmittanceParameters
from canhaptic.errors import InputError
from canhaptic.scene.document import Diagnostics, MarkedMapping
from canhaptic.scene.models import AxisScene, Scene


def check_display(axis: AxisScene, entry: MarkedMapping, scene: Scene, faults: Diagnostics) -> None:
    """Note missing properties of an admittance display, and an impedance display simulated as an admittance display."""
    display, simulation = axis.parameters.admittance, axis.simulation
    if display is None:
        if simulation is not None and simulation.admittance is not None:
            faults.add(entry.mark, "simulation.admittance: got one, but the axis has no `admittance`; add it there")
        return
    at = entry.value_at("admittance")
    if axis.simulated_drive is not None:
        faults.add(
            at, "got an admittance display, but this axis moves a simulated mechanism; expected a plant of its own"
        )
    if scene.bus.rpdo == "event":
        faults.add(
            at, "got an admittance display with rpdo: event, whose commands act at no known time; use synchronous"
        )
    if simulation is not None and simulation.admittance is None:
        faults.add(at, "got an admittance display, but simulation.admittance is missing; add loop, grip and sensor")
    if not scene.simulated:
        for key in _missing(axis.parameters, display):
            faults.add(at, f"{key}: missing; an admittance display on a real interface does not move without, add it")


def _missing(given: AxisParameters, display: AdmittanceParameters) -> list[str]:
    """Keys that real hardware needs and the axis lacks."""
    needed = {
        "admittance.position_low": display.position_low,
        "admittance.position_high": display.position_high,
        "admittance.acceleration_limit": display.acceleration_limit,
        "admittance.force.frozen_after": display.force.frozen_after,
        "speed_limit": given.speed_limit if "speed_limit" in given.model_fields_set else None,
        "watchdog: true": given.watchdog or None,
    }
    return [key for key, value in needed.items() if value is None]


def refuse_displays(scene: Scene, command: str) -> None:
    """Refuse a scene with admittance displays for a command that serves impedance displays only.

    Raises:
        InputError: It has one.
    """
    names = ", ".join(axis.parameters.name for axis in scene.axes if axis.parameters.admittance is not None)
    if names:
        raise InputError(
            f"{scene.source}: {names}: {command} takes impedance displays (motion in, torque out) only; "
            "use canhaptic run, touch, compare, sweep, design, accuracy, check or inspect"
        )

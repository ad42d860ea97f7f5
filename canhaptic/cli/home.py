"""`canhaptic commission --home CONFIG`: home one drive with its own homing mode, asking before it moves."""

import argparse
from dataclasses import replace

from canhaptic.axis_units import effort_unit
from canhaptic.canopen import objects as od
from canhaptic.cli.commission import dialogue_of
from canhaptic.cli.options import scene_of
from canhaptic.drive import homing
from canhaptic.errors import InputError
from canhaptic.host.stop_signal import StopSignal
from canhaptic.scene.build import build
from canhaptic.scene.buses import kind_of
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.view.terminal import write_line, write_note

_NOT_DONE = 1


def execute(arguments: argparse.Namespace) -> int:
    """Home the drive; return 0, or 1 if the person declined, 128 + n after signal n."""
    scene = scene_of(arguments)
    axis = _axis(scene, arguments.axis)
    _require_torque(axis, arguments.torque)
    order = homing.HomingOrder(arguments.method, tuple(arguments.speed), arguments.timeout)
    dialogue = dialogue_of(scene, yes=arguments.yes)
    if (kind := kind_of(scene.bus_of(axis))) != "can":
        text = f"{scene.source}: {axis.parameters.name} is on a bus of type {kind}, where a homing is not offered"
        why = "homing here writes the controlword by SDO, and a drive in OP takes it from its process data alone"
        raise InputError(f"{text}: {why}; home it with the vendor's tool, or set position_reference for its encoder")
    with build(_hands_off(scene)) as experiment:
        planned = next(drive for drive in experiment.rig.drives if drive.axis.name == axis.parameters.name)
        known = planned.axis.model_copy(update={"torque_limit": arguments.torque, "reset_fault": False})
        drive = homing.HomingDrive(planned.link, known, planned.dictionary, planned.bus, order)
        if not all(dialogue.confirm(question) for question in _questions(drive)):
            write_note("  nothing was sent")
            return _NOT_DONE
        with StopSignal() as stop:
            try:
                found = homing.home(drive, stop.requested)
            finally:
                for text in drive.unrestored:
                    write_note(f"  not put back in the drive: {text}")
    if found is None:
        write_note(f"  {known.name}: stopped before home was found; the drive was halted and disabled")
        return stop.exit_status
    before, after = found
    scale = known.direction / known.counts_per_unit
    write_line(f"{known.name}: home found by method {order.method}; the drive is disabled")
    for when, counts in (("before", before), ("after", after)):
        write_line(f"  position {when}: {counts} counts (0x6064), {counts * scale:.6g} {known.unit}")
    return 0


def _hands_off(scene: Scene) -> Scene:
    handles = ((axis, axis.simulation and replace(axis.simulation, user=None)) for axis in scene.axes)
    return replace(scene, axes=tuple(replace(axis, simulation=handle) for axis, handle in handles))


def _axis(scene: Scene, name: str | None) -> AxisScene:
    axes = [axis for axis in scene.axes if name in (None, axis.parameters.name)]
    if len(axes) != 1:
        raise InputError(f"--axis: got {name}, expected one of: {', '.join(a.parameters.name for a in scene.axes)}")
    return axes[0]


def _require_torque(axis: AxisScene, torque: float) -> None:
    """Refuse a torque above the axis's limit; with an unverified torque scale, above a hundredth of it.

    Raises:
        InputError: The torque is too large, or not above zero.
    """
    limit, unit = axis.loop.torque_limit or axis.parameters.torque_limit, effort_unit(axis.parameters.unit)
    if not 0.0 < torque <= limit:
        text = "; canhaptic commission verifies its scale, for more" if limit < axis.parameters.torque_limit else ""
        raise InputError(f"--torque: got {torque:g} {unit}, expected more than 0, at most {limit:g} {unit}{text}")


def _questions(drive: homing.HomingDrive) -> list[str]:
    """Return the questions that a person must answer with yes: what will move, how, how fast, at what torque."""
    axis, order = drive.axis, drive.order
    torque, speed = f"{axis.torque_limit:g} {effort_unit(axis.unit)}", " and ".join(f"{v:g}" for v in order.speeds)
    counts = " and ".join(str(round(v * axis.counts_per_unit)) for v in order.speeds)
    questions = []
    if not drive.takes_limit:
        questions.append(
            f"{axis.name}: this drive takes no torque limit from the bus (0x6072), so only its own current limit "
            f"bounds the homing torque. Is that limit set with the vendor's tool to at most {torque}?"
        )
    if od.VELOCITY_UNIT not in drive.dictionary:
        questions.append(f"{axis.name}: the drive does not list its velocity unit (0x60A9). Is 0x6099 in counts/s?")
    return [
        *questions,
        f"{axis.name} (node {axis.node_id}) will be enabled, hold its position, and be homed by method "
        f"{order.method}: {homing.METHODS[order.method]}; at {speed} {axis.unit}/s (0x6099: {counts} counts/s), with "
        f"at most {torque}, for at most {order.timeout:g} s. Smaller counts are towards "
        f"{'smaller' if axis.direction > 0 else 'larger'} positions of the axis. Hands off, path clear, emergency "
        "stop at hand?",
    ]

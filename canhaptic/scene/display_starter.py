"""Starter configuration of an admittance display: limits, sensor, mass, certificate, simulation.

All values scale with the torque limit, so that they fit together: a mass that the torque accelerates at 200 rad/s^2, a
velocity loop of 50 Hz, and a virtual mass that is passive without a guard.
"""

from math import pi
from string import Template
from typing import Final

from canhaptic.drive.profile.display_parameters import DisplayParameters
from canhaptic.scene.guesses import TO_SET
from canhaptic.scene.starter_simulation import JITTER, number, simulated_machine

_INERTIA: Final = 0.005  # per torque limit [s^2]
_BANDWIDTH: Final = 50.0  # of the velocity loop [Hz]
_OVER: Final = 1.1  # every over-estimate
_START_SPEED: Final = 0.05  # from which a hand moves it [rad/s]
_HELD: Final = 2.0  # times M + c tau: passive without a guard
_FRICTION: Final = 0.02  # of the torque limit: dry friction
_ACCELERATION: Final = 50.0  # commanded at most [rad/s^2]
_COUNTS: Final = 16384  # of the sensor up to its range

_AXIS: Final = Template(f"""\
    speed_limit: 2 rad/s    # {TO_SET}: a handle that is faster stops the rig
    admittance:             # force in, velocity out
      mode: $mode        # $mode_note
$velocity_counts$limited      acceleration_limit: $acceleration rad/s^2
      handle_acceleration: 80 rad/s^2 # {TO_SET}: by drive and hand together, an over-estimate
      position_low: -0.5 rad # {TO_SET}: lowest and highest position to which a command may lead
      position_high: 0.5 rad # {TO_SET}
      force:
$source        per_count: $per_count N*m # {TO_SET}: negative where the sensor counts the other way
        range: $range N*m # {TO_SET}: a force beyond it stops the rig
        error: $error N*m # {TO_SET}: offset, drift, noise, quantisation (canhaptic commission)
        slew: $slew N*m/s # {TO_SET}: largest change of the force per second, an over-estimate
        frozen_after: 50    # SYNCs with one count beyond `error`, then the rig stops
""")

_RENDERED: Final = Template(f"""\
# A free mass; the rig alone has about half of it. `lower_wall` and `upper_wall` limit its way.
environment:
  type: virtual_mass
  mass: $mass kg*m^2
  damping: $damping N*m*s/rad

# $certified
passivity:
  algorithm: guarded
  drive_mass: $drive_mass kg*m^2 # {TO_SET}: all that the drive moves up to the sensor, an over-estimate
  loop_gain: $gain N*m*s/rad # {TO_SET}: 2 pi bandwidth mass, an over-estimate (canhaptic commission)
  # Over-estimates with which force and motion are compared: an offset of the sensor, or a ramp in the drive, stops it.
  # drive_friction: $friction N*m
  # drive_damping: $bearings N*m*s/rad
$integral$timing  energy_allowance: $allowance J # given out at most; motion starts with it
""")

_CERTIFIED: Final = "Every command is certified by the drive's own velocity loop, for every hand."
_UNCERTIFIED: Final = (
    "Mode 8 has an integral: nothing is certified where holds are uneven (sync_jitter); mode 9 has none."
)

_BETWEEN: Final = Template("""\
  admittance:
    loop: {gain: $gain N*m*s/rad, integral_gain: $integral N*m/rad}
    grip: {mass: $grip kg*m^2, stiffness: $grip_stiffness N*m/rad, damping: $grip_damping N*m*s/rad}
    sensor: {noise: $noise N*m}
""")


def display_axis(display: DisplayParameters, counts: float, limit: float, unlimited: str, steepest: float) -> str:
    """Return the keys of an axis that make it an admittance display.

    Args:
        display: Findings of the dictionary for a display.
        counts: Position counts [count/rad].
        limit: Torque limit [N*m].
        unlimited: Reason why the start writes no limit to 0x6072; "" where it does.
        steepest: Largest value that the ramps of the drive accept [counts/s^2].
    """
    named = display.force.object
    node = f"        node: {{node_id: 9}}  # {TO_SET}: the drive has no analog input that is known\n"
    why = f"keep it once torque_limit is set with the vendor's tool (0x6072 is {unlimited})"
    is_velocity = display.mode == "velocity"
    scale = f"      velocity_counts: {counts:.10g} # {TO_SET}: counts of 0x60FF for 1 rad/s of the axis\n"
    return _AXIS.substitute(
        mode=display.mode,
        mode_note="mode 9, 0x60FF" if is_velocity else "mode 8, 0x607A, which the drive interpolates",
        velocity_counts=scale if is_velocity else "",
        acceleration=number(min(_ACCELERATION, 0.99 * steepest / counts) if is_velocity else _ACCELERATION),
        limited=f"      limit_in_drive: true # {TO_SET}: {why}\n" if unlimited else "",
        source=node
        if named is None
        else f"        object: {named}    # {TO_SET}: the input to which the sensor is wired\n",
        per_count=number(2.0 * limit / _COUNTS),
        range=number(2.0 * limit),
        error=number(4e-4 * limit),
        slew=number(25.0 * limit),
    )


def display_rendered(display: DisplayParameters, limit: float, sample_time: float, *, simulate: bool) -> str:
    """Return environment and passivity for a torque limit [N*m] and a sample time [s]."""
    mass, gain = _INERTIA * limit, _gain(limit)
    is_position = display.mode == "position"
    line = f"  integral_gain: {number(_OVER * 10.0 * gain)} N*m/rad # {TO_SET}: position gain times loop_gain\n"
    return _RENDERED.substitute(
        certified=_UNCERTIFIED if is_position and not simulate else _CERTIFIED,
        mass=number(_HELD * (mass + 1.5 * sample_time * gain)),
        damping=number(mass),
        drive_mass=number(_OVER * mass),
        gain=number(_OVER * gain),
        friction=number(_FRICTION * limit),
        bearings=number(2.0 * mass),
        integral=line if is_position else "",
        timing="" if simulate else JITTER,
        allowance=number(0.5 * _OVER * gain * sample_time * _START_SPEED**2),
    )


def display_simulation(display: DisplayParameters, objects: str, rated: float, limit: float) -> str:
    """Return the simulated rig; `objects` are lines of `simulation.drive`."""
    mass, gain = _INERTIA * limit, _gain(limit)
    between = _BETWEEN.substitute(
        gain=number(gain),
        integral=number(10.0 * gain if display.mode == "position" else 0.0),
        grip=number(0.15 * mass),
        grip_stiffness=number(1e4 * mass),
        grip_damping=number(10.0 * mass),
        noise=number(5e-5 * limit),
    )
    return simulated_machine(rated, objects, mass, mass, limit, "a hand that moves to and fro", between, (0.1, 2.0))


def _gain(limit: float) -> float:
    return 2.0 * pi * _BANDWIDTH * _INERTIA * limit

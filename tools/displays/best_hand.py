"""The hand that gets most energy out of an admittance display without feedback, in closed form, against its guard.

A linear display renders a mass m at its SYNCs; a drive M v' = c (r - v) + F follows. A hand whose force is constant in
each hold makes the displacements H F, H a lower triangular Toeplitz matrix, and puts in the energy F' H F. The smallest
eigenvalue of (H + H') / 2 says whether any hand gets energy out; its vector is that hand.

Of a declared drive mass m_d the guard lets a mass of nearly m_d + c T (delay + 1) / 2 be felt: in a ramp each command
that may act costs c T r^2 / 4. Where that is the mass asked for, and m_d is too small, the guard hardly cuts, and the
best hand takes what the linear display gives; with the true one it gets nothing. A lighter mass shows less: the guard
cuts while the hand pushes, and a light mass then follows it when it brakes. The loop is homogeneous in the force as
long as the largest acceleration of the handle is declared as it is.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, expm, toeplitz

from canhaptic.control.admittance import build_display_controller
from canhaptic.control.admittance.admittance_environment import AdmittanceMass
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.control.balance import Certificate

Array = NDArray[np.float64]
_STRENGTH: Final = 20.0  # of a hand [N]
_ASKED: Final = (0.9, 1.0, 1.2)  # times the lightest mass that a guard lets be felt
_LEAST: Final = 1e-12  # energy got out for a force of 1 N, below which no hand counts as one that gets any [J]
_TRIES: Final = 6


@dataclass(frozen=True)
class AttackedRig:
    """A drive with its loop, and what is declared of its mass."""

    time: float = 1e-3  # [s]
    delay: int = 1
    mass: float = 2.0  # [kg]
    bandwidth: float = 25.0  # of the loop [Hz]
    asked: float = 2.0  # virtual mass [kg]
    share: float = 1.0  # of the mass that is declared
    acceleration: float = 1.0  # declared of the handle [m/s^2]

    @property
    def gain(self) -> float:
        """Gain of the velocity loop [N*s/m]."""
        return 2.0 * math.pi * self.bandwidth * self.mass

    @property
    def lightest(self) -> float:
        """Lightest mass that its guard lets be felt, nearly [kg]."""
        return self.share * self.mass + 0.5 * self.gain * self.time * (self.delay + 1)

    def flow(self) -> Array:
        """Returns a hold as one matrix, shape (2, 4): displacement and speed after it; states q, v, inputs F, r."""
        m, c = self.mass, self.gain
        rates = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, -c / m, 1.0 / m, c / m], [0.0] * 4, [0.0] * 4])
        return np.asarray(expm(rates * self.time))[:2]


def best_hands(rig: AttackedRig, holds: int) -> tuple[Array, Array]:
    """Returns the energies that hands put into the linear display, ascending [J], and their forces as columns [N].

    Each hand has the length 1; a negative energy is one that it gets out.

    Args:
        rig: The display, which renders the mass asked for; what is declared of it does not count.
        holds: How long a hand acts.
    """
    flow, speed, command, moved = rig.flow(), 0.0, 0.0, []
    waiting = [0.0] * (rig.delay + 1)
    for hold in range(holds):
        force = 1.0 if hold == 0 else 0.0
        way, speed = flow @ np.array([0.0, speed, force, waiting.pop(0)])
        moved.append(float(way))
        command += rig.time * force / rig.asked
        waiting.append(command)
    matrix = np.tril(toeplitz(np.array(moved)))
    energies, forces = eigh(0.5 * (matrix + matrix.T))
    return energies, forces


@dataclass(frozen=True)
class Taken:
    """What a hand came to on the guard."""

    least: float  # energy that it put in, after any hold [J]
    cut: int  # holds in which the certificate was active
    acceleration: float  # largest of the handle, at least [m/s^2]


def taken(rig: AttackedRig, forces: Array) -> Taken:
    """Returns what a hand without feedback came to, under the guard."""
    properties = AdmittanceProperties(
        sample_time=rig.time, delay=rig.delay, sampling="mean", force_slew=1e-6, handle_acceleration=rig.acceleration,
        speed_limit=1e6, acceleration_limit=1e9,
    )  # fmt: skip
    known = GuardedAdmittanceParameters(drive_mass=rig.share * rig.mass, loop_gain=rig.gain, spread=0.0)
    controller: Any = build_display_controller(AdmittanceMass(mass=rig.asked), "guarded", known, properties)
    flow, waiting, position, speed, energy, least, cut, fastest = rig.flow(), [0.0] * (rig.delay + 1), *[0.0] * 6
    controller.step(0.0, 0.0)
    for force in forces:
        command = waiting.pop(0)
        before = speed
        way, speed = (float(value) for value in flow @ np.array([0.0, speed, force, command]))
        starts = (rig.gain * (command - before) + force, rig.gain * (command - speed) + force)
        fastest = max(fastest, *(abs(push) / rig.mass for push in starts))
        position, energy = position + way, energy + force * way
        balance = controller.step(position, -force)
        waiting.append(balance.torque)
        cut += balance.certificate == Certificate.VELOCITY_LOOP.value
        least = min(least, energy)
    return Taken(least, int(cut), fastest)


def with_true_acceleration(rig: AttackedRig, forces: Array) -> Taken | None:
    """Returns what a hand came to with the acceleration of the handle declared as it is; None where none was found."""
    rig = replace(rig, acceleration=1e-3)
    for _ in range(_TRIES):
        found = taken(rig, forces)
        if found.acceleration <= rig.acceleration:
            return found
        rig = replace(rig, acceleration=1.02 * found.acceleration)
    return None


def attacked(mutant: AttackedRig, lengths: tuple[int, ...] = (20, 60)) -> tuple[float, float] | None:
    """Returns the least energies of the best hands, of a mutant and of the true rig; None where no hand gets any.

    Args:
        mutant: A rig of which too little mass is declared.
        lengths: Numbers of holds for which a hand acts.
    """
    least: list[tuple[float, float]] = []
    for asked in _ASKED:
        rig = replace(mutant, asked=asked * mutant.lightest)
        for holds in lengths:
            energies, forces = best_hands(rig, holds)
            if energies[0] > -_LEAST:
                continue
            hand = forces[:, 0] * _STRENGTH / np.abs(forces[:, 0]).max()
            both = [with_true_acceleration(one, hand) for one in (rig, replace(rig, share=1.0))]
            least += [(one.least, other.least) for one, other in [both] if one is not None and other is not None]
    return (min(one for one, _ in least), min(other for _, other in least)) if least else None

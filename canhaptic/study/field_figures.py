"""The field's own figures of an algorithm on one axis: one definition each, with its source.

Figures of a run that are compared with the continuous environment (errors, force variation, limit cycle, stiffness
rendered) are in `figures.py`; the time of a step is in `cost.py`. Here is what the literature on haptic rendering asks
besides. Of the virtual mass (M-width) there is nothing: no environment of one axis has a mass.
"""

import math
from collections.abc import Callable, Iterable
from typing import Final

import numpy as np

from canhaptic.control.environments.environment import Environment
from canhaptic.study.loop import Array, LoopRun

_WINDOW: Final = 0.02
"""After the first contact, in which the force rises [s]."""


def energy_given_out(run: LoopRun) -> float:
    """Returns the most energy that the port had given out beyond what was put in, after any hold [J].

    Source: the condition that a passivity observer watches, Hannaford and Ryu 2002, doi:10.1109/70.988969; here with
    the energy of the plant, not the one booked.
    """
    return max(0.0, -run.least_interaction)


def energy_beyond_device(run: LoopRun, device_damping: float, sample_time: float) -> float:
    """Returns the most energy given out beyond what came in and what the device's own damping took, after any hold [J].

    A display is passive where this is 0, also where its environment alone is not: Colgate and Schenkel, "Passivity of a
    class of sampled-data systems", Journal of Robotic Systems 14, 1997 (its condition was read where others cite it).
    In a hold that moves D a damping b takes at least b D^2 / T.

    Args:
        run: Of an axis.
        device_damping: That is certain [N*s/m or N*m*s/rad].
        sample_time: [s].
    """
    moved = np.diff(run.true_position, prepend=run.true_position[:1])
    taken = np.cumsum(device_damping / sample_time * moved**2)
    return max(0.0, -float((run.interaction + taken).min(initial=0.0)))


def rate_hardness(run: LoopRun, environment: Environment, sample_time: float) -> float | None:
    """Returns the largest rate of the force after the first contact over the speed at it [N/m or N*m/rad].

    An ideal wall gives its stiffness. Source: Lawrence, Pao, Dougherty, Salada and Pavlou, "Rate-hardness: a new
    performance metric for haptic interfaces", IEEE Trans. Robotics and Automation 16, 2000 (its abstract was read).

    Args:
        run: That begins out of contact.
        environment: What was rendered.
        sample_time: [s].

    Returns:
        None where there was no contact, or the first one was reached without speed.
    """
    touching = np.array([bool(environment.contact(q)) for q in run.true_position.tolist()])
    if not touching.any() or touching[0]:
        return None
    first = int(touching.argmax())
    speed = abs(run.true_position[first] - run.true_position[first - 1]) / sample_time
    last = first + max(2, math.ceil(_WINDOW / sample_time))
    rates = np.diff(np.abs(run.torque[first : last + 1])) / sample_time
    return float(rates.max(initial=0.0) / speed) if speed > 0.0 else None


def drag(run: LoopRun) -> float | None:
    """Returns the mean size of the torque held out of contact [N or N*m]; None without such a hold.

    Free motion should feel like nothing: the lower end of the Z-width, Colgate and Brown, "Factors affecting the
    Z-width of a haptic display", ICRA 1994, pp. 3205-3210 (cited in what was read).
    """
    free = ~np.isfinite(run.damping[1:])  # no hold ends at the first SYNC
    return float(np.abs(run.torque[1:][free]).mean()) if free.any() else None


def rendered_impedance(run: LoopRun, sample_time: float, frequency: float) -> complex:
    """Returns force over velocity at one frequency, over the whole periods of the last half [N*s/m or N*m*s/rad].

    The transparency of a display is how near this is to the impedance asked for, over frequency. Held forces are taken
    as they act, constant over each hold; positions at their SYNCs.

    Args:
        run: Of a hand that moves with this frequency, always in contact.
        sample_time: [s].
        frequency: [Hz]; below half of the rate.
    """
    omega, count = 2.0 * math.pi * frequency, len(run.position)
    periods = max(1, math.floor(0.5 * count * sample_time * frequency))
    rows = np.arange(count - round(periods / (frequency * sample_time)), count)
    turn = np.exp(-1j * omega * sample_time * rows)
    half = 0.5 * omega * sample_time
    position = np.sum(run.true_position[rows] * turn)
    force = np.sum(-run.torque[rows] * turn) * np.exp(1j * half) * math.sin(half) / half
    return complex(force / (1j * omega * position))


def asked_impedance(stiffness: float, damping: float, frequency: float) -> complex:
    """Returns force over velocity of a spring with a damper [N*s/m or N*m*s/rad]."""
    return damping + stiffness / (2j * math.pi * frequency)


def stiffest(passes: Callable[[float], bool], stiffnesses: Iterable[float]) -> float:
    """Returns the largest stiffness that passes as all smaller ones do; 0 where not even the least does.

    Over the damping of the wall this is the border of the K-B plot, or Z-width: Colgate and Brown 1994, as above.

    Args:
        passes: Whether a wall of a stiffness is rendered well.
        stiffnesses: Those to be tried, rising [N/m or N*m/rad].
    """
    largest = 0.0
    for stiffness in stiffnesses:
        if not passes(stiffness):
            break
        largest = stiffness
    return largest


def stiffness_grid(least: float, most: float, per_decade: int) -> Array:
    """Returns stiffnesses that rise by equal factors, both ends included, shape (n,)."""
    count = 1 + round(per_decade * math.log10(most / least))
    return np.geomspace(least, most, count)

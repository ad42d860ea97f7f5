"""What a run without a bus shows of commanded velocities: the guard's part, and the mass and damping that are felt."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from canhaptic.control.balance import RANKS, Certificate
from canhaptic.lab.loop.axis_loop import Array, LoopRun
from canhaptic.scene.models import Scene

_STILL: Final = 1e-9  # smallest command that counts as motion [m/s or rad/s]
_FEWEST: Final = 30  # fewest SYNCs for a fit of the apparent mass


def guarded_shares(run: LoopRun) -> tuple[float, float, int]:
    """Return how often a certificate limited a command, how often no certificate held, and the weakest one.

    Returns:
        Share of the holds with a command in which a certificate limited it; share of all holds without a certificate;
        and the weakest certificate.
    """
    certificate = run.booked.certificate.astype(int)
    cuts = Certificate.VELOCITY_LOOP, Certificate.LARGEST_HAND_FORCE, Certificate.DECLARED_HAND
    cut = np.isin(certificate, [of.value for of in cuts])
    moving = np.count_nonzero(cut | (np.abs(run.booked.torque) > _STILL))
    weakest = max(certificate.tolist(), key=RANKS.__getitem__, default=Certificate.EXACT.value)
    cycles = max(1, len(certificate))
    return cut.sum() / max(1, moving), np.count_nonzero(certificate == Certificate.NONE.value) / cycles, weakest


def felt(run: LoopRun, scene: Scene) -> tuple[float, float]:
    """Return the apparent mass [kg or kg*m^2] and damping [N*s/m or N*m*s/rad], by least squares.

    F - k (q - rest) = m v' + b v + F_0 is fitted to true forces and velocities, with one m and b for all axes, away
    from walls and position limits. NaN where there is too little motion, and for a path, because its mass depends on
    the direction.
    """
    if len(scene.axes) > 1 and scene.ports[0].rendered.name != "virtual_mass":
        return float("nan"), float("nan")
    motion, time = run.motion[20:], scene.bus.sample_time
    if len(motion) < _FEWEST or not np.isfinite(motion).all() or np.ptp(motion[:, :, 1]) < _STILL:
        return float("nan"), float("nan")
    environment: Any = scene.ports[0].rendered.parameters
    rows, forces = [], []
    axes = motion.shape[1]
    for place in range(axes):
        position, speed, force = motion[1:-1, place, :].T
        rise = (motion[2:, place, 1] - motion[:-2, place, 1]) / (2.0 * time)
        part = environment.of_axis(place)
        spring = getattr(part, "stiffness", 0.0) * (position - getattr(part, "rest", 0.0))
        near = float(np.abs(speed).max()) * (3.0 * time + 10e-3)  # in which a drive stops
        is_free = _is_free(scene, place, position, near)
        rows.append(np.column_stack([rise, speed, np.tile(np.eye(axes)[place], (len(rise), 1))])[is_free])
        forces.append((force - spring)[is_free])
    every = np.concatenate(rows)
    if len(every) < _FEWEST:
        return float("nan"), float("nan")
    fit = np.linalg.lstsq(every, np.concatenate(forces), rcond=None)[0]
    return float(fit[0]), float(fit[1])


def _is_free(scene: Scene, place: int, position: Array, near: float) -> NDArray[np.bool_]:
    """Return at which SYNCs an axis is farther than `near` from its walls and limits, shape (n,)."""
    rendered: Any = scene.ports[0].rendered.parameters
    environment = rendered.of_axis(place)
    display = scene.axes[place].parameters.admittance
    low, high = getattr(display, "position_low", None), getattr(display, "position_high", None)
    low = max(environment.lower_wall, -np.inf if low is None else low)
    high = min(environment.upper_wall, np.inf if high is None else high)
    return np.asarray((position > low + near) & (position < high - near))

"""The prediction in a loop with a spring: the roots of the loop for a mass that is declared too small."""

import numpy as np
import pytest

from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import PredictedMotion, observe, predicted, prediction_settings

BEYOND = 0.75  # holds, the default of `guarded`


def growth(delay: int, stiffness: float, mass: float) -> float:
    """Growth of the fastest motion in a hold: of a true mass, declared as 1 kg, in holds of 1 s without a hand."""
    settings = prediction_settings(LoopProperties(sample_time=1.0, delay=delay, moving_mass=1.0), BEYOND)

    def following(state: list[float]) -> list[float]:
        position, velocity, *rest = state
        motion, torques = PredictedMotion(*rest[:3]), rest[3:]
        way, _ = predicted(settings, motion, torques, 0, 0.0)
        torques.append(-stiffness * (position + way))
        held = torques.pop(0)
        moved = velocity + 0.5 * held / mass
        observe(settings, motion, moved, held)
        return [position + moved, velocity + held / mass, motion.step, motion.push, motion.rise, *torques]

    loop = np.array([following(unit) for unit in np.eye(5 + delay).tolist()]).T
    return float(max(abs(np.linalg.eigvals(loop)))) - 1.0


@pytest.mark.slow_but("1-*")
@pytest.mark.parametrize(("delay", "certified", "times"), [(0, 0.5, 7.5), (1, 1.0 / 6.0, 3.0), (2, 1.0 / 12.0, 2.0)])
def test_a_mass_declared_too_small_makes_no_motion_grow_but_slowly(delay: int, certified: float, times: float) -> None:
    """The figures of the module, for springs up to the stiffest that is certified, k T^2 / m."""
    springs = np.geomspace(1e-5, certified, 25).tolist()
    assert max(growth(delay, k, mass) for k in springs for mass in (1.0, 0.5 * (1.0 + times), times)) < 1e-9
    fastest = max(growth(delay, k, mass) for k in springs for mass in np.geomspace(times, 300.0, 25))
    assert 0.0025 < fastest < 0.0051

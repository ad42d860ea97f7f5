"""One example of every environment, and the loop on which every algorithm can run."""

import importlib.util

from canhaptic.haptics.environments.spring_damper_wall import SpringDamperWall
from canhaptic.haptics.passivity import ALGORITHMS, build_controller
from canhaptic.haptics.passivity.protocol import LoopProperties

# name -> (environment, its mirror image: q -> -q)
EXAMPLES = {
    "spring_damper_wall": (
        SpringDamperWall(stiffness=800.0, damping=4.0, position=0.004),
        SpringDamperWall(stiffness=800.0, damping=4.0, position=-0.004, side="above"),
    ),
}

SAMPLE_TIME = 1e-3


def algorithms():
    """Names of every algorithm whose module is there."""
    return [name for name, path in ALGORITHMS.items() if importlib.util.find_spec(path.partition(":")[0]) is not None]


def loop(delay=0, sample_time=SAMPLE_TIME):
    """Everything known, so that no algorithm lacks what it needs."""
    return LoopProperties(
        sample_time=sample_time, delay=delay, moving_mass=0.25, device_damping=0.2, device_damping_bound=0.4
    )


def controller(algorithm, environment, delay=0, parameters=None):
    return build_controller(environment, algorithm, parameters, loop(delay))

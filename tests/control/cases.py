"""One example of every environment, and the loop on which every algorithm can run."""

import importlib.util

from canhaptic.control.environments.coulomb_surface import CoulombSurface
from canhaptic.control.environments.damper_wall import DamperWall
from canhaptic.control.environments.detents import Detents
from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.environments.hardening_wall import HardeningWall
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.two_sided_wall import TwoSidedWall
from canhaptic.control.environments.viscoelastic_medium import ViscoelasticMedium
from canhaptic.control.environments.viscous_medium import ViscousMedium
from canhaptic.control.passivity import ALGORITHMS, LoopProperties, build_controller

# name -> (environment, its mirror image: q -> -q)
EXAMPLES = {
    "spring_damper_wall": (
        SpringDamperWall(stiffness=800.0, damping=4.0, position=0.004),
        SpringDamperWall(stiffness=800.0, damping=4.0, position=-0.004, side="above"),
    ),
    "two_sided_wall": (
        TwoSidedWall(stiffness=600.0, damping=3.0, lower=-0.006, upper=0.004),
        TwoSidedWall(stiffness=600.0, damping=3.0, lower=-0.004, upper=0.006),
    ),
    "hardening_wall": (
        HardeningWall(stiffness=200.0, hardening=2e6, damping=2.0, position=0.002),
        HardeningWall(stiffness=200.0, hardening=2e6, damping=2.0, position=-0.002, side="above"),
    ),
    "detents": (
        Detents(peak=2.0, pitch=0.01, damping=0.5, position=0.0037),
        Detents(peak=2.0, pitch=0.01, damping=0.5, position=-0.0037),
    ),
    "viscous_medium": (ViscousMedium(damping=6.0),) * 2,
    "viscoelastic_medium": (ViscoelasticMedium(stiffness=500.0, relaxation_time=0.05, damping=1.0),) * 2,
    "coulomb_surface": (CoulombSurface(friction=1.5, stiffness=2000.0, damping=0.5),) * 2,
    "damper_wall": (DamperWall(damping=8.0, position=0.003), DamperWall(damping=8.0, position=-0.003, side="above")),
    "free_space": (FreeSpace(),) * 2,
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

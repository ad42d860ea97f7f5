"""One example of every environment, and the loop on which every algorithm can run."""

import importlib.util

from canhaptic.control.environments.coulomb_surface import CoulombSurface
from canhaptic.control.environments.damper_wall import DamperWall
from canhaptic.control.environments.detents import Detents
from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.environments.hardening_wall import HardeningWall
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.sum_of_parts import added
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


def _knob(position, lower, upper):
    """Notches that do not begin at the stops, in a medium."""
    detents = Detents(peak=2.0, pitch=0.004, damping=0.5, position=position)
    stops = TwoSidedWall(stiffness=600.0, damping=3.0, lower=lower, upper=upper)
    return added([("detents", detents), ("stops", stops), ("medium", ViscousMedium(damping=6.0))])


def _in_water(position, side):
    wall = SpringDamperWall(stiffness=800.0, damping=4.0, position=position, side=side)
    return added([("wall", wall), ("water", ViscousMedium(damping=6.0))])


def _layers(position, further, side):
    """A wall behind a softer one, and a damper that begins inside both."""
    return added([
        ("soft", HardeningWall(stiffness=200.0, hardening=2e6, damping=2.0, position=position, side=side)),
        ("hard", SpringDamperWall(stiffness=800.0, position=further, side=side)),
        ("oil", DamperWall(damping=8.0, position=2.0 * further - position, side=side)),
    ])  # fmt: skip


SUMS = {
    "knob": (_knob(0.0007, -0.006, 0.004), _knob(-0.0007, -0.004, 0.006)),
    "wall_in_water": (_in_water(0.004, "below"), _in_water(-0.004, "above")),
    "layers": (_layers(0.003, 0.001, "below"), _layers(-0.003, -0.001, "above")),
}
EVERY = {**EXAMPLES, **SUMS}

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

"""A group whose step is compiled does what the interpreted one does: the same formulas, unfolded from their source.

The text that numba compiles is plain Python as well, and is held against the classes without numba here; what numba
makes of it is held against them in the slow tests.
"""

import math
import random
from pathlib import Path

import numpy as np
import pytest

from canhaptic.control.mechanisms.five_bar import FiveBar
from canhaptic.control.mechanisms.identity import Identity
from canhaptic.control.mechanisms.planar_2r import Planar2R
from canhaptic.control.mechanisms.transmission import Transmission
from canhaptic.control.mechanisms.user_function import UserFunction
from canhaptic.control.multi_axis import NETWORKS, _why_interpreted
from canhaptic.control.port_hamiltonian.network import Network, UserEnergy
from canhaptic.control.port_hamiltonian.shapes.anisotropic_spring import AnisotropicSpring
from canhaptic.control.port_hamiltonian.shapes.box import Box
from canhaptic.control.port_hamiltonian.shapes.coupled_handles import CoupledHandles
from canhaptic.control.port_hamiltonian.shapes.general import General
from canhaptic.control.port_hamiltonian.shapes.geometry import LinearGeometry, Rendered
from canhaptic.control.port_hamiltonian.shapes.guided_path import GuidedPath
from canhaptic.control.port_hamiltonian.shapes.moving_wall import MovingWall
from canhaptic.control.port_hamiltonian.shapes.plane import Plane
from canhaptic.control.port_hamiltonian.shapes.sphere import Sphere
from canhaptic.control.port_hamiltonian.shapes.tube import Tube
from canhaptic.control.port_hamiltonian.shapes.virtual_mass import MassOnSpring
from canhaptic.cycle import run
from canhaptic.errors import ControlError, ParameterError
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from tests.control.network.networks import EXAMPLE, group

pytest.importorskip("numba")

from canhaptic.control.multi_axis import compiled_group

CONFIGS = Path(__file__).resolve().parents[3] / "configs"
TOLERANCE = 1e-12  # of the largest value of each figure in the run
STAGE = Identity(axes=2)
FIVE_BAR = FiveBar(
    base=0.1, proximal=(0.15, 0.15), distal=(0.2, 0.2), workspace_lower=(-0.1, 0.05), workspace_upper=(0.1, 0.4)
)
WALL = {"stiffness": 1500.0, "damping": 3.0}
BOX = Box(lower=(-0.005, -0.005), upper=(0.005, 0.005), **WALL)
CHAIN = General(
    storages=(
        {"type": "spring", "stiffness": 800.0, "hardening": 1e6}, {"type": "mass", "mass": 0.3},
        {"type": "double_well", "hardening": 1e7, "well": 0.005},
    ),
    dissipators=(
        {"type": "damper", "viscous": 1.0, "coulomb": 0.3, "squared": 2.0, "states": {1: 1.0}},
        {"type": "damper", "viscous": 1.0, "ports": {0: 1.0}},
    ),
    structure=((0.0, -1.0, 0.0), (1.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
    gain=((1.0, 0.0), (0.0, 0.0), (0.0, 1.0)),
)  # fmt: skip
LIGHT = {"moving_mass": 1e-3, "device_damping_bound": 1e-3}
CASES = {
    "plane": (Plane(normal=(1.0, 1.0), **WALL), STAGE, {}, {}),
    "box": (BOX, STAGE, {}, {}),
    "body": (Box(lower=(-0.005, -0.005), upper=(0.005, 0.005), side="outside", **WALL), STAGE, {}, {}),
    "sphere": (Sphere(centre=FIVE_BAR.forward((2.2, 0.9)), radius=0.03, **WALL), FIVE_BAR, {}, {}),
    "tube": (Tube(point=(0.0, 0.0), direction=(1.0, 0.5), radius=0.003, **WALL), STAGE, {}, {}),
    "anisotropic_spring": (
        AnisotropicSpring(
            centre=(0.0, 0.0), stiffness=((500.0, 100.0), (100.0, 800.0)), damping=((2.0, 0.5), (0.5, 3.0))
        ), STAGE, {}, {},
    ),
    "moving_wall": (MovingWall(normal=(1.0, 0.0), amplitude=0.01, frequency=1.0, **WALL), STAGE, {}, {}),
    "virtual_mass": (EXAMPLE, STAGE, {}, {}),
    "mass_on_spring": (
        MassOnSpring(mass=0.3, stiffness=800.0, anchor=(0.0, 0.0), anchor_stiffness=50.0), STAGE, {}, {},
    ),
    "coupled_handles": (CoupledHandles(stiffness=800.0, damping=2.0, scale=2.0), STAGE, {}, {}),
    "guided_path": (
        GuidedPath(points=((-0.01, 0.0), (0.01, 0.0), (0.01, 0.01)), stiffness=800.0, damping=1.0, width=0.001),
        STAGE, {}, {},
    ),
    "general": (CHAIN, STAGE, {}, {}),
    "coarse": (BOX, STAGE, {"encoder_count": 1e-5, "torque_quantum": 0.01, "torque_limit": 3.0}, {}),
    "options": (
        EXAMPLE, STAGE, {"device_damping": 0.05, "torque_limit": 3.0},
        {"hand_force": 5.0, "hand_speed": 1.0, "credit": 1e-3, "alpha": "200 s/m^2"},
    ),
    "transmission": (
        EXAMPLE, Transmission(matrix=((0.05, 0.05), (0.05, -0.05)), workspace_lower=(-0.05, -0.05)), LIGHT, {},
    ),
    "arm": (Sphere(centre=(0.2, 0.1), radius=0.03, **WALL), Planar2R(first=0.2, second=0.15), {}, {}),
    "one axis": (Plane(normal=(1.0,), **WALL), Identity(axes=1), {}, {}),
    "three axes": (Sphere(centre=(0.0, 0.0, 0.0), radius=0.005, **WALL), Identity(axes=3), {}, {}),
}  # fmt: skip
REACHES = {"sphere": (2.2, 0.9, 0.3), "arm": (0.3, 0.9, 0.7), "transmission": (0.0, 0.0, 0.6)}


def without_numba(functions, source):
    """The step as Python runs it."""
    plain = "def njit(*_given, **_options):\n    return lambda function: function\n"
    names = {}
    exec(functions.replace("from numba import njit", plain), names)
    exec(source.replace("from numba import njit", plain), names)
    return names["group_step"]


def figures(balance):
    return [
        *balance.torques, *balance.account, *balance.interactions, balance.supplied, balance.unsure, balance.limit,
    ]  # fmt: skip


def path_of(name, axes, count):
    *middle, reach = REACHES.get(name, (*(0.0,) * axes, 0.01))

    def positions(k):
        found = [m + reach * math.sin((0.04 + 0.013 * i) * k + i) for i, m in enumerate(middle)]
        return [count * round(p / count) for p in found] if count else found

    return positions


def pair(name, delay):
    environment, kinematics, known, own = CASES[name]
    return [
        group(environment, kinematics.axes, delay=delay, kinematics=kinematics, known=known, compiled=compiled, **own)  # type: ignore[attr-defined]
        for compiled in (False, True)
    ]


def largest_difference(name, delay, cycles):
    """Drives both along one path through losses and torques cut short; returns it over the largest of each figure."""
    interpreted, compiled = pair(name, delay)
    axes, known = interpreted.axes, CASES[name][2]
    path, rng = path_of(name, axes, known.get("encoder_count", 0.0)), random.Random(1)
    pending, held = [(0.0,) * axes] * delay, (0.0,) * axes
    largest, apart = [0.0] * (18 + 2 * axes), [0.0] * (18 + 2 * axes)
    for k in range(cycles):
        lost = k > 2 and rng.random() < 0.01
        balances = [each.hold() if lost else each.step(path(k), held) for each in (interpreted, compiled)]
        for i, (a, b) in enumerate(zip(*map(figures, balances), strict=True)):
            largest[i], apart[i] = max(largest[i], abs(a)), max(apart[i], abs(a - b))
        pending.append(balances[0].torques)
        held = pending.pop(0)
        if rng.random() < 0.02:
            held = tuple(0.5 * torque for torque in held)
    assert largest[0] > 0.1  # something was rendered
    assert compiled.interpreted < cycles / 4
    return max(a / m for a, m in zip(apart, largest, strict=True) if m)


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("name", CASES)
def test_the_unfolded_source_is_the_step_of_the_classes(monkeypatch, name, delay):
    monkeypatch.setattr(compiled_group, "compiled", without_numba)
    assert largest_difference(name, delay, 400) <= TOLERANCE


def test_every_environment_of_the_table_is_among_the_cases():
    environments = {type(environment).__name__ for environment, *_ in CASES.values()}
    assert {place.rsplit(":", 1)[1] for place in NETWORKS.values()} <= environments


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", CASES)
def test_the_compiled_step_is_the_step_of_the_classes(name):
    assert largest_difference(name, 1, 3000) <= TOLERANCE


def closed_loop(name, compiled, cycles):
    """Figures of a shipped scene over the whole CAN path, each run on a plant of its own."""
    together = ["groups.0.passivity.lost_frames=0"]  # axes that may act apart have no compiled form
    compiling = ["groups.0.passivity.compiled=true"] if compiled else []
    scene = load_scene(CONFIGS / f"{name}.yaml", together + compiling)
    found = []
    with build(scene, "free") as experiment:
        (member,) = experiment.cycle.groups
        assert isinstance(member.controller, compiled_group.CompiledGroup) == compiled
        run(experiment.cycle, cycles=cycles, progress=lambda _cycle: found.append(figures(member.balance)))
    return found


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["xy_box", "five_bar_sphere", "two_handles"])
def test_a_compiled_scene_closes_its_loop_as_the_interpreted_one(name):
    one, other = (np.array(closed_loop(name, compiled, 1500)) for compiled in (False, True))
    largest, apart = np.abs(one).max(axis=0), np.abs(one - other).max(axis=0)
    assert largest[0] > 0.1
    assert (apart <= TOLERANCE * largest).all()


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_nothing_is_compiled_once_the_controller_is_built():
    from numba.core import event

    interpreted, compiled = pair("one axis", 1)
    path = path_of("one axis", 1, 0.0)
    with event.install_recorder("numba:compile") as recorder:
        for k in range(200):
            compiled.hold() if k % 50 == 20 else compiled.step(path(k), (0.0,))
    assert recorder.buffer == []
    assert compiled.interpreted < 20
    assert interpreted.axes == 1


def test_other_parameters_of_the_same_network_need_no_other_source(monkeypatch):
    monkeypatch.setattr(compiled_group, "compiled", without_numba)
    sources = {
        group(Plane(normal=(1.0, 1.0), stiffness=k, damping=d), compiled=True, known={"moving_mass": m}).source
        for k, d, m in ((800.0, 2.0, 0.3), (1500.0, 3.0, 0.2))
    }
    assert len(sources) == 1


def test_an_error_leaves_a_compiled_group_to_be_reset(monkeypatch):
    monkeypatch.setattr(compiled_group, "compiled", without_numba)
    _, compiled = pair("box", 1)
    for k in range(5):
        compiled.step((0.001 * k, 0.0), (0.0, 0.0))
    with pytest.raises(ControlError, match="finite"):
        compiled.step((math.nan, 0.0), (0.0, 0.0))
    assert compiled.step((0.02, 0.0), (0.0, 0.0)).torques == (0.0, 0.0)  # the first after a reset only takes positions


def test_what_python_alone_can_do_is_named_and_interpreted():
    mechanism = UserFunction(lambda q: [q[0], q[1]], lambda _q: [[1.0, 0.0], [0.0, 1.0]], at=(0.0, 0.0))
    controller = group(BOX, kinematics=mechanism, compiled=True)
    assert "function of one's own" in _why_interpreted(controller)
    assert _why_interpreted(group(BOX)) == ""


def test_energies_given_as_functions_are_refused_in_a_group():
    class Own:
        def build(self, dimensions):
            energy = UserEnergy(1, lambda x: 50.0 * x[0] ** 2, lambda x: [100.0 * x[0]])
            return Rendered(Network([energy], gain=[[1.0]]), LinearGeometry([[1.0, 0.0]], [0.0]))

    with pytest.raises(ParameterError, match="leave it out"):
        group(Own(), compiled=True)


def test_without_numba_a_compiled_group_names_the_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "canhaptic.control.multi_axis.compiled_group", None)
    with pytest.raises(ParameterError, match=r"canhaptic\[fast\]"):
        group(EXAMPLE, compiled=True)

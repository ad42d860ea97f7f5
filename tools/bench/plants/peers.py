"""The easy scene in other simulators, each in the loop that a user of it would write; absent ones are left out.

What each gets ready beforehand is not timed; a force that depends on time only is worked out beforehand for all.
"""

import importlib.util
import math
from collections.abc import Callable, Iterator
from importlib import import_module
from time import perf_counter
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from tools.bench.plants.scenes import DAMPING, MASS, PERIOD, Array, Scene

Run = Callable[[], Array]
PEERS = {
    "MuJoCo": "mujoco",
    "MuJoCo RK4": "mujoco",
    "Drake RK3": "pydrake",
    "python-control discrete": "control",
    "scipy solve_ivp": "scipy",
    "motulator": "motulator",
    "Runge-Kutta 4 by hand": "math",
}


def peers(scene: Scene) -> dict[str, Run | None]:
    """Returns what runs the easy scene in each peer; None for a peer that is not installed."""
    makers = {
        "MuJoCo": lambda: mujoco_loop(scene, "Euler"),
        "MuJoCo RK4": lambda: mujoco_loop(scene, "RK4"),
        "Drake RK3": lambda: drake_loop(scene),
        "python-control discrete": lambda: control_loop(scene),
        "scipy solve_ivp": lambda: scipy_loop(scene),
        "motulator": lambda: motulator_loop(scene),
        "Runge-Kutta 4 by hand": lambda: by_hand(scene),
    }
    return {name: makers[name]() if importlib.util.find_spec(PEERS[name]) else None for name in PEERS}


def state_space(scene: Scene) -> tuple[Array, Array]:
    """Returns A and B of the easy scene with states position, velocity, sine, cosine."""
    user = scene.user
    assert user.motion is not None
    omega, amplitude = 2.0 * math.pi * user.motion.frequency, user.motion.amplitude
    target, speed = user.stiffness * amplitude / MASS, user.damping * amplitude * omega / MASS
    rates = [
        [0.0, 1.0, 0.0, 0.0],
        [-user.stiffness / MASS, -(user.damping + DAMPING) / MASS, target, speed],
        [0.0, 0.0, 0.0, omega],
        [0.0, 0.0, -omega, 0.0],
    ]
    return np.array(rates), np.array([[0.0], [1.0 / MASS], [0.0], [0.0]])


def mujoco_model(scene: Scene, integrator: str, timestep: float = PERIOD, extra: str = "") -> Any:
    """Returns the slide joint with the hand as its spring and damper; the hand's motion comes as a force."""
    mujoco = import_module("mujoco")
    user = scene.user
    return mujoco.MjModel.from_xml_string(f"""
<mujoco><option timestep="{timestep!r}" gravity="0 0 0" integrator="{integrator}"><flag contact="disable"/></option>
<worldbody><body><joint name="x" type="slide" axis="1 0 0" stiffness="{user.stiffness}"
damping="{user.damping + DAMPING}" {extra}/><geom type="sphere" size="0.01" mass="{MASS}"/></body></worldbody>
<actuator><motor joint="x"/></actuator></mujoco>""")


def hand_forces(scene: Scene, count: int, step: float) -> Array:
    """Returns the force of the hand's motion at the start of each step [N]."""
    user = scene.user
    assert user.motion is not None
    omega = 2.0 * math.pi * user.motion.frequency
    phase = omega * step * np.arange(count)
    forces: Array = user.motion.amplitude * (user.stiffness * np.sin(phase) + user.damping * omega * np.cos(phase))
    return forces


def mujoco_loop(scene: Scene, integrator: str, substeps: int = 1) -> Run:
    """Returns `mj_step` in a loop."""
    mujoco = import_module("mujoco")
    step = PERIOD / substeps
    model = mujoco_model(scene, integrator, step)
    forces = np.repeat(scene.torques, substeps) + hand_forces(scene, len(scene.torques) * substeps, step)
    commands = forces.tolist()

    def run() -> Array:
        data, move, positions = mujoco.MjData(model), mujoco.mj_step, []
        control, place = data.ctrl, data.qpos
        for command in commands:
            control[0] = command
            move(model, data)
            positions.append(place[0])
        return np.array(positions[substeps - 1 :: substeps])

    return run


def drake_loop(scene: Scene) -> Run:
    """Returns `Simulator.AdvanceTo` with Runge-Kutta 3 at fixed steps of one period, on a linear system in C++."""
    analysis = import_module("pydrake.systems.analysis")
    a, b = state_space(scene)
    system = import_module("pydrake.systems.primitives").LinearSystem(
        A=a, B=b, C=np.eye(4), D=np.zeros((4, 1)), time_period=0.0
    )
    torques = scene.torques[:, None]

    def run() -> Array:
        simulator = analysis.Simulator(system)
        analysis.ResetIntegratorFromFlags(simulator, "runge_kutta3", PERIOD)
        simulator.get_mutable_integrator().set_fixed_step_mode(True)
        context = simulator.get_mutable_context()
        context.SetContinuousState([0.0, 0.0, 0.0, 1.0])
        fix, positions = system.get_input_port().FixValue, []
        fix(context, torques[0])
        simulator.Initialize()
        for k, torque in enumerate(torques):
            fix(context, torque)
            simulator.AdvanceTo((k + 1) * PERIOD)
            positions.append(context.get_continuous_state_vector().GetAtIndex(0))
        return np.array(positions)

    return run


def control_loop(scene: Scene) -> Run:
    """Returns the discrete system of python-control, stepped from Python."""
    control = import_module("control")
    a, b = state_space(scene)
    system = control.c2d(control.ss(a, b, np.eye(4), np.zeros((4, 1))), PERIOD)
    torques = scene.torques[:, None]

    def run() -> Array:
        state, positions = np.array([0.0, 0.0, 0.0, 1.0]), []
        for k, torque in enumerate(torques):
            state = system.dynamics(k * PERIOD, state, torque)
            positions.append(state[0])
        return np.array(positions)

    return run


def by_hand(scene: Scene) -> Run:
    """Returns Runge-Kutta 4 in Python's floats, one step a period, with the equation as a function."""
    user, h, torques = scene.user, PERIOD, scene.torques.tolist()
    assert user.motion is not None
    k, d, size, omega = user.stiffness, user.damping, user.motion.amplitude, 2.0 * math.pi * user.motion.frequency

    def rate(t: float, x: float, v: float, torque: float) -> float:
        push = k * (size * math.sin(omega * t) - x) + d * (size * omega * math.cos(omega * t) - v)
        return (torque + push - DAMPING * v) / MASS

    def run() -> Array:
        t = x = v1 = 0.0
        positions = []
        for torque in torques:
            a1 = rate(t, x, v1, torque)
            a2 = rate(t + 0.5 * h, x + 0.5 * h * v1, v2 := v1 + 0.5 * h * a1, torque)
            a3 = rate(t + 0.5 * h, x + 0.5 * h * v2, v3 := v1 + 0.5 * h * a2, torque)
            a4 = rate(t + h, x + h * v3, v4 := v1 + h * a3, torque)
            x, v1, t = x + h / 6 * (v1 + 2 * v2 + 2 * v3 + v4), v1 + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4), t + h
            positions.append(x)
        return np.array(positions)

    return run


def scipy_loop(scene: Scene) -> Run:
    """Returns `solve_ivp` called once a period with its defaults."""
    torques = scene.torques.tolist()

    def run() -> Array:
        state, positions = np.array(scene.start), []
        for k, torque in enumerate(torques):
            result = solve_ivp(scene.smooth, (k * PERIOD, (k + 1) * PERIOD), state, args=(torque,))
            state = result.y[:, -1]
            positions.append(state[0])
        return np.array(positions)

    return run


class Torques:
    """The control system of motulator's loop: gives the torques in turn and reads the position."""

    def __init__(self, scene: Scene) -> None:
        self.torques: Iterator[float] = iter(scene.torques.tolist())
        self.positions: list[float] = []

    def __call__(self, model: Any) -> tuple[float, float]:
        """Returns the sample time and the torque of the next period."""
        self.positions.append(float(np.real(model.get_initial_values()[0])))
        return PERIOD, next(self.torques, 0.0)

    def post_process(self) -> None:
        """Keeps nothing."""


def motulator_servo(scene: Scene) -> Callable[[], Any]:
    """Returns what makes servo and hand as one subsystem of motulator."""
    subsystem: Any = import_module("motulator.common.model").Subsystem

    class Servo(subsystem):  # type: ignore[misc]
        """Servo and hand."""

        def __init__(self) -> None:
            super().__init__()
            self.state = SimpleNamespace(position=0.0, velocity=0.0)
            self.sol_states = SimpleNamespace(position=[], velocity=[])
            self.time = 0.0

        def set_outputs(self, t: float) -> None:
            """Keeps the time for the hand's motion."""
            self.time = t

        def rhs(self) -> list[float]:
            """Returns the rates."""
            state = self.state
            return list(scene.smooth(self.time, (state.position, state.velocity), self.inp.force))

    return Servo


def motulator_rig(scene: Scene) -> Callable[[], Any]:
    """Returns what makes a model of motulator: the servo behind a converter that passes the torque on."""
    system: Any = import_module("motulator.common.model").Model
    make_servo = motulator_servo(scene)

    class Rig(system):  # type: ignore[misc]
        """The servo behind its converter."""

        def __init__(self) -> None:
            super().__init__(pwm=lambda period, torque: ([period], [torque]), delay=1)
            self.delay = lambda torque: torque
            self.converter = SimpleNamespace(inp=SimpleNamespace(q_cs=0.0), sol_q_cs=[], data=SimpleNamespace())
            self.servo = make_servo()
            self.subsystems = [self.servo]

        def post_process(self) -> None:
            """Keeps nothing."""

        def interconnect(self, t: float) -> None:
            """Gives the servo its torque."""
            self.servo.inp.force = self.converter.inp.q_cs

    return Rig


def motulator_loop(scene: Scene) -> Run:
    """Returns motulator's own simulation loop around a model with servo and hand."""
    simulation = import_module("motulator.common.model._simulation")
    make_rig = motulator_rig(scene)

    def run() -> Array:
        controller = Torques(scene)
        simulation.Simulation(make_rig(), controller).simulate(t_stop=(len(scene.torques) + 0.5) * PERIOD)
        return np.array(controller.positions[1 : len(scene.torques) + 1])

    return run


def mujoco_stick() -> float | None:
    """Returns how far MuJoCo's dry friction of 0.5 N lets 0.3 N creep in 10 s [m]; None when it is absent."""
    if not importlib.util.find_spec("mujoco"):
        return None
    mujoco = import_module("mujoco")
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco><option timestep="{PERIOD!r}" gravity="0 0 0"><flag contact="disable"/></option><worldbody><body>
<joint name="x" type="slide" axis="1 0 0" frictionloss="0.5"/><geom type="sphere" size="0.01" mass="{MASS}"/>
</body></worldbody><actuator><motor joint="x"/></actuator></mujoco>""")
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.3
    for _ in range(10_000):
        mujoco.mj_step(model, data)
    return float(abs(data.qpos[0]))


def mujoco_rollout(scene: Scene, count: int = 500) -> Callable[[], float] | None:
    """Returns what measures cycles per second of `mujoco.rollout` on one thread; None when it is absent."""
    if not importlib.util.find_spec("mujoco"):
        return None
    mujoco, rollout = import_module("mujoco"), import_module("mujoco.rollout")
    model = mujoco_model(scene, "Euler")
    data = mujoco.MjData(model)
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    start = np.zeros((count, size))
    cycles = len(scene.torques)
    control = np.tile((scene.torques + hand_forces(scene, cycles, PERIOD))[None, :, None], (count, 1, 1))

    def run() -> float:
        begin = perf_counter()
        rollout.rollout(model, data, start, control)
        return count * cycles / (perf_counter() - begin)

    return run

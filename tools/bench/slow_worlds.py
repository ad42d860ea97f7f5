"""The rows of `far_worlds` that are of a slow program behind a rig: random programs, broken rules, and MuJoCo at 60 Hz.

A ball and a block in MuJoCo, stalls of 50 and 500 ms, a block that jumps by up to 60 mm into the hand; with it the same
world behind a rig that holds the world's force between its turns, without a guard.
"""

import tempfile
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import yaml

import canhaptic
from canhaptic.logs.energy_reader import EnergyLog
from tools.attack.far import FALSE, GIVEN, first_false
from tools.attack.worlds import OF_A_WORLD, outcome
from tools.bench.report import Row, kept_folder
from tools.kept_runs import run_kept

_RIG: Final = "configs/far_world.yaml"
_WITHIN: Final = 300
_LENGTH: Final = 3.0  # of a random world [s]
_TURN: Final = 1.0 / 60.0
_ASKED: Final = 2000.0  # [N/m]
_TOUCH: Final = 0.03  # of the proxy, with the ball between it and the block [m]
_DRAG: Final = 4.0 * 0.04 * 2.0 * np.pi * 0.5  # torque of `drag` at the largest speed of that hand [N]
_HANDS: Final = 10
_BALL: Final = """<mujoco><option timestep="0.0041666667" integrator="implicitfast" gravity="0 0 0"/><worldbody>
<body><joint name="x" type="slide" axis="1 0 0"/><geom type="sphere" size=".01" mass=".2"/></body>
<body pos=".03 0 0"><joint type="slide" axis="1 0 0" damping="2"/><geom type="sphere" size=".01" mass=".5"/></body>
<body name="block" mocap="true" pos=".07 0 0"><geom type="box" size=".01 .1 .1"/></body></worldbody>
<actuator><general joint="x" gainprm="800" biastype="affine" biasprm="0 -800 -16" ctrlrange="-1 1"/></actuator>
</mujoco>"""


class Turn(NamedTuple):
    """What MuJoCo says after a turn."""

    touches: bool
    at: float  # [m]
    speed: float  # [m/s]
    work: float  # that the hand's spring did on the proxy [J]
    force: float  # of that spring on the proxy [N]
    stall: float  # that follows [s]


class Ball:
    """A proxy that a spring draws to the hand, a ball, and a block that may jump."""

    def __init__(self, seed: int, *, stalls: bool, jumps: bool) -> None:
        import mujoco

        self._step, self._random = mujoco.mj_step, np.random.default_rng(seed)
        self._model = mujoco.MjModel.from_xml_string(_BALL)
        self._data, self._stalls, self._jumps = mujoco.MjData(self._model), stalls, jumps

    def turn(self, position: float) -> Turn:
        """Advances 1/60 s towards a hand."""
        data, draw, work = self._data, self._random.random, 0.0
        if self._jumps and draw() < 0.05:
            data.mocap_pos[0, 0] = 0.07 + 0.09 * draw() - 0.06
        data.ctrl[0] = position
        for _ in range(4):
            before = data.qpos[0]
            self._step(self._model, data)
            work += data.actuator_force[0] * (data.qpos[0] - before)
        touches = any(0 in (of.geom1, of.geom2) for of in data.contact[: data.ncon])
        drawn = draw()
        stall = 0.0 if not self._stalls or drawn < 0.93 else 0.05 if drawn < 0.99 else 0.5
        return Turn(touches, float(data.qpos[0]), float(data.qvel[0]), work, float(data.actuator_force[0]), stall)


def hand_of(seed: int) -> dict[str, Any]:
    """Returns the hand of a seed; the hand of seed 0 presses slowly and for long."""
    random = np.random.default_rng(seed)
    amplitude, frequency = (60.0, 0.5) if seed == 0 else (random.uniform(30.0, 70.0), random.uniform(0.4, 1.5))
    motion = {"type": "sinusoid", "amplitude": f"{amplitude:.4g} mm", "frequency": f"{frequency:.4g} Hz"}
    return {"simulation.user.motion": motion, "simulation.seed": seed, "duration": "5 s"}


def behind_a_wall(ball: Ball, seed: int, log: Path | None = None) -> float:
    """Returns the least energy that came in at the motor [J], where the rig renders a wall of the world's."""
    with canhaptic.World("virtual", scene=_RIG, changes=hand_of(seed), energy_log=log) as world:
        for hand in world:
            now = ball.turn(hand["handle"].position)
            world["handle"].absorbed(now.work)
            if now.touches:
                world["handle"].wall(at=now.at, speed=now.speed, stiffness=_ASKED, pushes="-", damping=6.0)
            else:
                world["handle"].free()
            if now.stall:
                world.pause(now.stall)
    assert world.result is not None
    return float(world.result["truth"]["handle"]["least_interaction"])


def by_held_force(ball: Ball, seed: int, log: Path | None = None) -> float:
    """Returns the same where the rig holds the force of the world from turn to turn."""
    scene = yaml.safe_load(Path(_RIG).read_text(encoding="utf-8"))
    del scene["far"]
    scene["passivity"], scene["environment"] = {"algorithm": "unprotected"}, {"type": "free_space"}
    scene["axes"][0].update(energy_loss_limit="none", eds="eds/cia402_servo.eds")
    due, force = 0.0, 0.0
    with canhaptic.open_rig(scene, hand_of(seed), guard="none", energy_log=log) as rig:
        for cycle, sample in enumerate(rig):
            if 1e-3 * cycle >= due:
                now = ball.turn(sample["handle"].position)
                force = -now.force if now.touches else 0.0
                due += _TURN + now.stall
            rig["handle"].torque = force
    return float(rig.account.raw["truth"]["handle"]["least_interaction"])


def pressed(log: Path) -> tuple[float, float]:
    """Returns the stiffness felt at the last press [N/m], and by how much the torque swings there [N]."""
    with EnergyLog.open(log) as opened:
        position, torque = (
            opened.ports["handle"]["position"][4200:4800],
            opened.ports["handle"]["torque_applied"][4200:4800],
        )
    hard = position > 0.999 * position.max()
    return float(np.mean(-torque[hard] / (position[hard] - _TOUCH))), float(np.ptp(torque[hard]))


def in_mujoco() -> list[Row]:
    """Returns what a hand feels of a ball in MuJoCo, and what the rig gives out, next to the world's held force."""
    rows = []
    for name, rig in (("local wall", behind_a_wall), ("the world's force, held", by_held_force)):
        is_ours = rig is behind_a_wall
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "a.h5"
            rig(Ball(0, stalls=False, jumps=False), 0, log)
            felt, ripple = pressed(log)
        title = f"world: MuJoCo at 60 Hz, {name}"
        target, met = (">= 1500", felt >= 0.75 * _ASKED) if is_ours else ("", None)
        rows.append(Row(f"{title}: felt, 2 kN/m asked", felt, "N/m", target=target, met=met))
        rows.append(Row(f"{title}: ripple while pressed", ripple, "N"))
        for stalls, jumps in ((False, False), (True, False), (True, True)):
            seeds = range(1, _HANDS + 1)
            least = min(rig(Ball(seed, stalls=stalls, jumps=jumps), seed) for seed in seeds)
            what = f"{title}{', stalls' * stalls}{', jumps' * jumps}: given out"
            target, met = ("0", least >= FALSE) if is_ours else ("", None)
            rows.append(Row(what, max(0.0, -least), "J", target=target, met=met))
    return rows


def step_of_torque() -> Row:
    """Returns by how much the torque steps where a wall of 2 kN/m jumps 60 mm over a hand that rests."""
    still = {
        "simulation.user.motion": {"type": "sinusoid", "amplitude": "40 mm", "frequency": "0.5 Hz"},
        "duration": "4 s",
    }
    largest, turns = 0.0, 0
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "a.h5"
        with canhaptic.World("virtual", scene=_RIG, changes=still, energy_log=log) as world:
            for hand in world:
                turns += 1
                there = 0.06 if turns % 40 < 20 else 0.0  # and back
                world["handle"].wall(at=hand["handle"].position - 0.03 + there, stiffness=_ASKED, pushes="-")
        with EnergyLog.open(log) as opened:
            largest = float(np.abs(np.diff(opened.ports["handle"]["torque_applied"][:-5])).max())  # at its end it stops
    return Row("world: a wall that jumps 60 mm over the hand: largest step of torque", largest, "N",
               target=f"<= {_DRAG:.2f}, that of drag", met=largest <= _DRAG)  # fmt: skip


def random_worlds(wanted: int, minutes: float, jobs: int) -> list[Row]:
    """Returns the rows of the random worlds, and after how many each broken line of the rule is found."""
    kept = kept_folder() / "slow_worlds_runs.jsonl"
    done = run_kept(partial(outcome, length=_LENGTH), range(wanted + wanted // 4), kept, jobs, minutes=minutes).values()
    found = [came for came in done if came[2] > 0.0]
    false, share = sum(one[0] < FALSE for one in found), sum(one[1] < GIVEN for one in found) / max(1, len(found))
    rows = [
        Row("world: random worlds with torque", len(found), "1", target=">= 2000", met=len(found) >= 2000),
        Row("world: of these false", false, "1", target="0", met=not false),
        Row("world: the rig gave out 1 mJ of the program's", share, "1"),
    ]
    for name, number in OF_A_WORLD.items():
        broken = first_false(partial(outcome, length=_LENGTH, mutant=number), range(1, _WITHIN + 1))
        value, target = broken or _WITHIN, f"<= {_WITHIN}"
        rows.append(Row(f"world: mutant: {name}", value, "worlds", target=target, met=broken is not None))
    return rows


def rows_of_worlds(worlds: int, minutes: float, jobs: int) -> list[Row]:
    """Returns every row of a slow world."""
    return [step_of_torque(), *in_mujoco(), *random_worlds(worlds, minutes, jobs)]

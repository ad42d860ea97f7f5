"""How fast are sweeps of plants with stops and friction, and how soon is the first row of a second start there?

For comparison MuJoCo moves a slide with dry friction and a limit, in a loop of Python that computes the wall's torque.
"""

import importlib.util
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import numpy as np

from canhaptic.lab.batch.marching import run_batch
from canhaptic.scene.load import load_scene
from tools.bench.report import Row

REPOSITORY = Path(__file__).resolve().parents[2]
CONFIG = REPOSITORY / "configs" / "demo.yaml"
SCENES, CYCLES = 300, 1000
FIVE = ("diverged", "least_interaction", "margin", "accounted_error", "torque_peak")
MOVING = ("environment.position=0.005", "simulation.user.motion.frequency=3")
STOP = "{type: hard_stop, side: upper, position: 0.02, stiffness: 1e5, damping: 50}"
PLANTS = {
    "stop and Coulomb friction": f"{STOP}, {{type: coulomb_friction, kinetic: 0.3, static: 0.4}}",
    "stop and Stribeck friction": f"{STOP}, {{type: stribeck_friction, kinetic: 0.3, static: 0.5, "
    "stribeck_velocity: 0.01}",
    "current loop and friction": "{type: current_loop, time_constant: 300 us}, "
    "{type: coulomb_friction, kinetic: 0.3, static: 0.4}",
    "shaft and backlash": "{type: shaft_compliance, stiffness: 1e4, damping: 1, load_mass: 0.1}, "
    "{type: backlash, gap: 1e-4}",
}
ASKED = "stop and Coulomb friction"


def event_rows() -> list[Row]:
    """Returns cycles per second of one core's time of `guarded` on plants with events, compiled beforehand."""
    peer = _mujoco_loop()
    rows = []
    for name, effects in PLANTS.items():
        scene = load_scene(CONFIG, [*MOVING, f"simulation.effects=[{effects}]"])
        varied = {"environment.stiffness": np.geomspace(300.0, 3000.0, SCENES)}
        run_batch(scene, varied, 3, "numba", FIVE)
        begin = process_time()
        run_batch(scene, varied, CYCLES, "numba", FIVE)
        rate = SCENES * CYCLES / (process_time() - begin) / 1e6
        asked, met = (">= 0.5", rate >= 0.5) if name == ASKED else ("", None)
        ratio = rate / peer if peer else None
        label = f"{SCENES} scenes x {CYCLES} cycles: guarded, numba, {name}"
        rows.append(Row(label, rate, "M cycles/s", "MuJoCo loop in Python", peer, ratio, asked, met))
    return rows


def _mujoco_loop() -> float | None:
    """Returns the cycles per second of one core's time [1e6/s]; None when MuJoCo is absent."""
    if not importlib.util.find_spec("mujoco"):
        return None
    mujoco = import_module("mujoco")
    model = mujoco.MjModel.from_xml_string("""
<mujoco><option timestep="0.001" gravity="0 0 0"><flag contact="disable"/></option><worldbody><body>
<joint name="x" type="slide" axis="1 0 0" frictionloss="0.3" limited="true" range="-1 0.02" stiffness="60" damping="5"/>
<geom type="sphere" size="0.01" mass="0.25"/></body></worldbody><actuator><motor joint="x"/></actuator></mujoco>""")
    data, count = mujoco.MjData(model), 20_000
    push = (9.0 * np.sin(2.0 * np.pi * 3.0 * 1e-3 * np.arange(count))).tolist()
    before, begin = 0.0, process_time()
    for k in range(count):
        position = float(data.qpos[0])
        wall = -1000.0 * (position - 0.005) - 10.0 * (position - before) * 1e3 if position < 0.005 else 0.0
        data.ctrl[0], before = wall + push[k], position
        mujoco.mj_step(model, data)
    return count / (process_time() - begin) / 1e6


def start_rows() -> list[Row]:
    """Returns the processor time of small sweeps: of two kinds of scene without machine code on disk, then with it."""
    command = [
        sys.executable, "-m", "canhaptic", "sweep", str(CONFIG), "--vary", "environment.stiffness=1e2:1e5:log:40",
        "--vary", "environment.damping=0:10:40", "--cycles", "1000", "--engine", "numba", "--json",
    ]  # fmt: skip
    stop = ["--set", f"simulation.effects=[{PLANTS[ASKED]}]"]
    starts: tuple[tuple[str, list[str]], ...] = (
        ("first start", []),
        (f"first start after that, {ASKED}", stop),
        ("second start", []),
    )
    rows = []
    with TemporaryDirectory() as cache:
        for name, words in starts:
            before, begin = os.times(), perf_counter()
            where = {**os.environ, "XDG_CACHE_HOME": cache}
            subprocess.run([*command, *words], cwd=REPOSITORY, env=where, stdout=subprocess.DEVNULL, check=True)
            after = os.times()
            used = after.children_user + after.children_system - before.children_user - before.children_system
            note = (
                f"{perf_counter() - begin:.2f} s by the clock; 1,600 scenes of 1,000 cycles, all of them in one chunk"
            )
            asked, met = ("<= 2", used <= 2.0) if name == "second start" else ("", None)
            label = f"{name}: command to the end of a sweep, processor time"
            rows.append(Row(label, used, "s", target=asked, met=met, note=note))
    return rows

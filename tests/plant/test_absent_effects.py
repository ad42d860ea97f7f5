"""An effect that a scene does not name has no state, no executed line and no import; proved without a clock."""

import gc
import os
import subprocess
import sys
import tracemalloc
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from canhaptic.cycle import run as run_cycles
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.sim.plant import effects as effects_package
from canhaptic.sim.plant.plant import Plant
from tests.plant.plant_scenes import MS, make_plant, run

REPOSITORY = Path(__file__).resolve().parents[2]
STOP = {"type": "hard_stop", "position": 0.01, "stiffness": 1e6, "damping": 30}
COULOMB = {"type": "coulomb_friction", "kinetic": 0.3, "static": 0.5}
SHAFT = {"type": "shaft_compliance", "stiffness": 1e5, "load_mass": 0.1}
CURRENT = {"type": "current_loop", "time_constant": 5e-5}
COGGING = {"type": "cogging", "amplitude": 0.1, "pitch": 0.01}
LUGRE = {
    "type": "lugre_friction", "kinetic": 0.3, "static": 0.5, "stribeck_velocity": 0.01, "bristle_stiffness": 1e5,
}  # fmt: skip
TREMOR = {"type": "tremor", "amplitude": 1e-3}
SATURATION = {"type": "torque_saturation", "limit": 1.0}
FAR_STOP = {**STOP, "position": 0.5}
FAR_GRASP = {"type": "grasp_change", "time": 100.0, "stiffness": 500, "damping": 5}
VISCOUS = {"type": "viscous_friction", "damping": 0.2}
THERMAL = {"type": "thermal_derating", "torque_limit": 2, "copper_loss": 1, "thermal_resistance": 9, "time_constant": 1}
BARE = ("position", "velocity", "motion_sine", "motion_cosine", "torque", "one")

ADDED: list[tuple[dict[str, Any], set[str]]] = [
    (STOP, {"upper_stop_depth"}),
    (COULOMB, set()),
    (SHAFT, {"twist", "load_velocity"}),
    (CURRENT, {"motor_torque"}),
    (COGGING, {"travel", "effort"}),
    (LUGRE, {"travel", "effort", "bristle_deflection"}),
    (TREMOR, {"tremor_sine", "tremor_cosine"}),
    (SATURATION, set()),
    (VISCOUS, set()),
    (THERMAL, {"winding_temperature"}),
]


@pytest.mark.parametrize(("effect", "added"), ADDED, ids=lambda value: value["type"] if isinstance(value, dict) else "")
def test_a_scene_has_exactly_the_states_it_names(effect, added):
    assert make_plant().state_names == BARE
    assert set(make_plant(effect).state_names) - set(BARE) == added
    assert make_plant(user=None).state_names == ("position", "velocity", "torque", "one")


SCRIPT = """
import sys
{leak}
sys.path[:0] = [{tests!r}]
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.registry import load
from canhaptic.sim.plant.effects import EFFECTS
effects = [load(EFFECTS, e["type"], "effect").validated(e) for e in {effects!r}]
plant = Plant(PlantParameters(mass=0.25), None, effects, 1_000_000)
plant.begin(0)
for k in range(3):
    plant.advance_to((k + 1) * 1_000_000, 1.0)
print(*sorted(m for m in sys.modules if m.startswith("canhaptic.sim") or m in ("scipy", "numba", "can", "canopen")))
"""


def imported(effects: list[dict[str, Any]], leak: str = "") -> set[str]:
    script = SCRIPT.format(leak=leak, tests=str(REPOSITORY), effects=effects)
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, env=environment, timeout=60
    )
    return set(done.stdout.split())


def effect_modules(modules: set[str]) -> set[str]:
    return {name.rpartition(".")[2] for name in modules if name.startswith("canhaptic.sim.plant.effects.")}


@pytest.mark.slow
def test_a_scene_imports_only_the_modules_of_its_effects():
    bare = imported([])
    assert effect_modules(bare) == set()
    assert not {"scipy", "numba", "can", "canopen"} & bare
    assert effect_modules(imported([STOP])) == {"hard_stop"}
    assert effect_modules(imported([COULOMB, CURRENT])) == {"coulomb_friction", "current_loop"}


def executed(plant: Plant, holds: int = 4) -> Counter[tuple[str, str]]:
    """Bytecodes executed per (file, function) in some holds, the first one excluded."""
    counts: Counter[tuple[str, str]] = Counter()

    def trace(frame: FrameType, event: str, _argument: object) -> Any:
        frame.f_trace_opcodes = True
        if event == "opcode":
            counts[Path(frame.f_code.co_filename).name, frame.f_code.co_name] += 1
        return trace

    plant.begin(0)
    plant.advance_to(MS, 0.0)
    previous = sys.gettrace()
    gc.collect()
    gc.disable()  # a collection calls back into other packages
    sys.settrace(trace)
    try:
        for k in range(1, holds + 1):
            plant.advance_to((k + 1) * MS, 0.0)
    finally:
        sys.settrace(previous)
        gc.enable()
    return counts


def test_a_bare_scene_executes_the_same_bytecodes_when_every_effect_is_gone(monkeypatch):
    with_package = executed(make_plant())
    monkeypatch.setattr(effects_package, "EFFECTS", {})
    for name in [name for name in sys.modules if name.startswith("canhaptic.sim.plant.effects.")]:
        monkeypatch.delitem(sys.modules, name)
    without = executed(make_plant())
    assert with_package == without
    assert sum(without.values()) // 4 <= 120  # per hold
    assert {file for file, _ in without} == {"plant.py", "<a plant written out>"}


@pytest.mark.slow_but("effects0")
@pytest.mark.parametrize(
    "effects",
    [[SATURATION], [FAR_STOP], [FAR_STOP, SATURATION], [COULOMB], [FAR_GRASP], [FAR_GRASP, FAR_STOP, SATURATION]],
)
def test_a_clip_or_a_guard_that_this_hold_cannot_reach_adds_no_bytecode(effects, monkeypatch):
    """The torque is 0, the hand sets out slowly, and what breaks away is far from its level."""
    if effects != [SATURATION]:
        monkeypatch.setattr("canhaptic.sim.plant.plant.can_be_flat", lambda scene: False)
    assert executed(make_plant(*effects), 60) == executed(make_plant(), 60)


@pytest.mark.parametrize("effect", [STOP, COULOMB, LUGRE, SHAFT])
def test_a_plant_repeats_itself_bit_for_bit_after_reset(effect):
    plant = make_plant(effect)
    torques = [2.0 * (k % 7 - 3) for k in range(200)]
    first, energy = run(plant, torques), plant.energy()
    plant.reset()
    assert run(plant, torques).tobytes() == first.tobytes()
    assert plant.energy() == energy


@pytest.mark.parametrize("holds", [9.0, 70.0003, 130.9999, 192.0])
def test_a_grasp_that_changes_after_holds_without_a_look_changes_at_its_tick(holds):
    """The other plant is stopped inside every hold, so that none of its holds is taken ahead."""
    grasp = {**FAR_GRASP, "time": holds * 1e-3, "stiffness": 50}
    ahead, slow = make_plant(grasp, FAR_STOP), make_plant(grasp, FAR_STOP)
    ahead.begin(0)
    slow.begin(0)
    for k in range(1, 220):
        ahead.advance_to(k * MS, 0.3)
        slow.advance_to(k * MS - MS // 2, 0.3)
        slow.advance_to(k * MS, 0.3)
        assert ahead.position == pytest.approx(slow.position, rel=1e-10, abs=1e-15)
    assert ahead.products < slow.products


WHOLE = {
    "configs/demo.yaml": set(),
    "configs/two_handles.yaml": set(),
    "configs/hard/sim_stop_1khz.yaml": {"hard_stop.py", "contact.py"},
    "configs/hard/sim_lugre_presliding.yaml": {
        "splitting.py",
        "lugre_friction.py",
        "contact.py",
    },
    "configs/five_bar_sphere.yaml": {"five_bar_linkage.py", "task_hand.py"},
}
"""Scene -> files of effects and mechanisms that a whole run executes, all of them named by it."""


@pytest.mark.slow
@pytest.mark.parametrize("scene", WHOLE)
def test_a_whole_run_executes_and_allocates_in_no_file_of_an_effect_that_it_does_not_name(scene):
    top = str(Path(effects_package.__file__).parents[1])
    common = {"plant.py", "flat.py", "hybrid_automaton.py", "stepper.py", "assembly.py", "propagator.py", "user.py"}
    common |= {"__init__.py"}
    seen: set[str] = set()

    def trace(frame: FrameType, _event: str, _argument: object) -> None:
        if frame.f_code.co_filename.startswith(top):
            seen.add(Path(frame.f_code.co_filename).name)

    tracemalloc.start()
    previous = sys.getprofile()
    sys.setprofile(trace)
    try:
        with build(load_scene(REPOSITORY / scene)) as experiment:
            run_cycles(experiment.cycle, 25)
            states = [set(plant.state_names) for plant in experiment.plants]
            held = tracemalloc.take_snapshot().filter_traces([tracemalloc.Filter(True, f"{top}/*")])
    finally:
        sys.setprofile(previous)
        tracemalloc.stop()
    allocated = {Path(statistic.traceback[0].filename).name for statistic in held.statistics("filename")}
    assert seen - common <= WHOLE[scene]
    assert allocated - common <= WHOLE[scene]
    assert WHOLE[scene] <= seen
    named = {"upper_stop_depth", "travel", "effort", "bristle_deflection"} if WHOLE[scene] else set()
    assert all(names <= set(BARE) | named for names in states)

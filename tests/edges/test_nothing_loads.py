"""From the contact on nothing can be opened or loaded, as without descriptors: the stop is in order all the same."""

import subprocess
import sys
from pathlib import Path

import pytest

_PROGRAM = """
import errno, sys
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene

class Refuses:
    def find_spec(self, name, path=None, target=None):
        raise OSError(errno.EMFILE, "Too many open files", name)

wall = "environment={type: spring_damper_wall, stiffness: 800, damping: 2}"
scene = load_scene("configs/demo.yaml", (wall, "simulation.user={damping: 5, push: -5}"))
wants = []

def progress(done):
    if done == 30:
        assert experiment.far_side.drives[0].torque
        sys.meta_path.insert(0, Refuses())
        wants.append(1)

with build(scene, "free") as experiment:
    result, error = experiment.run_through(60, lambda: bool(wants), progress)
    [drive] = experiment.far_side.drives
    is_off = not drive.torque and not drive.servo.is_powered
    print(experiment.rig.stop_reason.name, error, is_off, experiment.cycle.holds_of_stop > 2, list(result["ports"]))
"""


@pytest.mark.slow
def test_a_run_that_can_load_nothing_any_more_stops_in_order_with_its_account() -> None:
    words, folder = [sys.executable, "-c", _PROGRAM], Path(__file__).parents[2]
    seen = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert seen.stdout == "OPERATOR None True True ['handle']\n", seen.stderr

"""Own code that returns no number a force can be ends the run: torque zero first, then one error with who and when."""

from pathlib import Path

import numpy as np
import pytest

from canhaptic.cli.main import main
from canhaptic.errors import OwnCodeError
from canhaptic.own_results import watch
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import declared_order, method_line, simulation_of
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import OwnHand

ROOT = Path(__file__).resolve().parents[2]
KINDS = {
    "hand": (
        "simulation.user={type: mine.py:Mine, stiffness: 60, damping: 5}",
        """
from canhaptic.extending import OwnHand


class Mine(OwnHand):
    def force(self, time, position, velocity):
        return VALUE if time > 0.02 else 0.0
""",
        "Mine before 0.021 s: force",
    ),
    "environment": (
        "environment={type: mine.py:Mine}",
        """
from canhaptic.extending import Environment


class Mine(Environment):
    def effort(self, state):
        return VALUE if abs(state) > 0.002 else 200.0 * state
""",
        "Mine: effort",
    ),
    "effect": (
        "simulation.effects=[{type: mine.py:Mine}]",
        """
from typing import ClassVar

from canhaptic.extending import NonlinearForce, Parameters, PlantModel


class Mine(Parameters):
    order: ClassVar[int | None] = 2
    rank: ClassVar[int] = 1
    type: str = "mine"

    def add_to(self, scene: PlantModel) -> None:
        scene.efforts.append(Pull())


class Pull(NonlinearForce):
    account = "dissipated"

    def force(self, position, travel, duration, torque):
        return VALUE if abs(position) > 0.003 else 0.0
""",
        "Pull before 0.028 s: force",
    ),
    "algorithm": (
        "passivity={algorithm: mine.py:Mine}",
        """
from canhaptic.control.passivity.unprotected import Unprotected


class Mine(Unprotected):
    steps = 0

    def step(self, position, torque_applied):
        self.steps += 1
        balance = super().step(position, torque_applied)
        return balance._replace(torque=VALUE) if self.steps > 20 else balance
""",
        "Mine: step",
    ),
}
VALUES = {
    "nan": ("float('nan')", "returned nan"),
    "inf": ("-float('inf')", "returned -inf"),
    "1e308": ("1e308", "returned 1e+308"),
    "text": ("'much'", "returned 'much'"),
    "none": ("None", "returned None"),
    "raises": ("1.0 / 0.0", "raised ZeroDivisionError: float division by zero (mine.py:"),
}


def scene_in(folder: Path, program: str) -> Path:
    """Writes the demo, and the program with it."""
    text = (ROOT / "configs" / "demo.yaml").read_text().replace("../eds", str(ROOT / "eds"))
    (folder / "scene.yaml").write_text(text)
    (folder / "mine.py").write_text(program)
    return folder / "scene.yaml"


@pytest.mark.slow_but("algorithm-nan", "environment-nan", "hand-nan", "algorithm-raises", "algorithm-1e308")
@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("kind", KINDS)
def test_no_number_ends_the_run_with_who_and_when(kind, value, tmp_path, capsys):
    section, program, who = KINDS[kind]
    returned, seen = VALUES[value]
    path = scene_in(tmp_path, program.replace("VALUE", returned))
    words = ["run", str(path), "--duration", "0.2", "--pace", "free", "--allow-code", "--set", section]
    assert main(words) == 3
    error = " ".join(capsys.readouterr().err.split())
    assert "canhaptic: error: the cycle failed at SYNC " in error
    assert "torque is zero: mine.py:" in error
    assert f"{who} {seen}" in error
    assert error.count("error:") == 1


class _Broken(OwnHand):
    def force(self, time: float, position: float, velocity: float) -> float:
        return float("nan") if time > 0.003 else 0.0


def test_a_plant_whose_hand_failed_stands_until_it_is_reset():
    plant = Plant(PlantParameters(mass=0.25, initial_velocity=0.1), _Broken(), [], 1_000_000)
    for _ in range(2):
        with pytest.raises(OwnCodeError, match=r"test_own_numbers\.py:_Broken before 0\.004 s: force returned nan"):
            plant.run(np.zeros(10))
        there = plant.position
        plant.run(np.full(3, 5.0))
        assert plant.position == there > 0.0
        plant.reset()


def test_an_own_hand_is_of_order_two_and_not_called_exact(tmp_path):
    section, program, _ = KINDS["hand"]
    scene = load_scene(scene_in(tmp_path, program.replace("VALUE", "0.0")), [section], allow_code=True)
    assert declared_order(simulation_of(scene.axes[0])) == 2
    assert method_line(scene).startswith("plant exact between SYNCs but for hand Mine of order 2; torque acts")


def test_methods_inherited_from_the_package_are_left_as_they_are():
    before = OwnHand.force
    watch(_Broken, ("force",))
    assert OwnHand.force is before

"""A network is designed for a group: what passes is rendered, and what the rig cannot render does not pass."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from canhaptic.cli.main import main
from canhaptic.errors import InputError
from canhaptic.scene.load import load_scene
from canhaptic.study.design.group_trial import GroupTrial

CONFIGS = Path(__file__).resolve().parents[3] / "configs"


def trial_of(name: str, *overrides: str) -> GroupTrial:
    return GroupTrial(load_scene(CONFIGS / f"{name}.yaml", list(overrides)), 0.05, "python")


def test_a_box_passes_until_the_rig_cannot_render_it() -> None:
    verdict = trial_of("xy_box").verdict(np.array([2000.0, 2000.0, 2e6]), np.array([0.0, 8.0, 0.0]))
    assert verdict.passed.tolist() == [True, True, False]
    assert verdict.stiffness_share[:2] == pytest.approx([1.0, 1.0], abs=0.03)
    assert verdict.damping_share[1] == pytest.approx(1.0, abs=0.03)
    assert np.isnan(verdict.damping_share[0])
    assert (verdict.least_interaction[:2] >= -1e-6).all()


def test_hands_lean_where_they_pushed_most() -> None:
    trial = trial_of("five_bar_sphere")
    (leaning, _), (moving, time) = trial._hands()
    assert moving is trial.scene
    assert time == pytest.approx(2.5)
    hand = leaning.mechanisms[0].hand
    assert hand is not None
    assert hand.motions == (None, None)
    assert hand.rest != trial.scene.mechanisms[0].hand.rest


def test_what_cannot_be_designed_is_said() -> None:
    with pytest.raises(InputError, match="no one stiffness and damping"):
        trial_of("xy_box", "groups.0.network={type: anisotropic_spring, stiffness: [[1, 0], [0, 1]], centre: [0, 0]}")


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["xy_box", "five_bar_sphere"])
def test_the_network_that_is_designed_is_a_scene(name: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["design", str(CONFIGS / f"{name}.yaml"), "--engine", "python", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    pasted = yaml.safe_load(result["yaml"])["groups"][0]
    assert result["stiffness_rendered"] == pytest.approx(1.0, abs=0.05)
    assert result["damping_rendered"] == pytest.approx(1.0, abs=0.05)
    scene = load_scene(CONFIGS / f"{name}.yaml", [f"groups.0.network={yaml.safe_dump(pasted['network'])}"])
    verdict = GroupTrial(scene, 0.05, "python").verdict(np.array([result["stiffness"]]), np.array([result["damping"]]))
    assert verdict.passed.all()

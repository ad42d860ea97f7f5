"""A network is designed for a group: what passes is rendered, and what the rig cannot render does not pass."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from canhaptic.cli.main import main
from canhaptic.errors import InputError
from canhaptic.lab.studies.design.trial import NetworkTrial, network_scale
from canhaptic.scene.load import load_scene

CONFIGS = Path(__file__).resolve().parents[3] / "configs"


def trial_of(name: str, *overrides: str) -> NetworkTrial:
    return NetworkTrial(load_scene(CONFIGS / f"{name}.yaml", list(overrides)), 0.05, "python")


@pytest.mark.slow
def test_a_box_passes_until_the_rig_cannot_render_it() -> None:
    verdict = trial_of("xy_box").verdict(np.array([2000.0, 2000.0, 2e6]), np.array([0.0, 8.0, 0.0]))
    assert verdict.passed.tolist() == [True, True, False]
    assert verdict.stiffness_share[:2] == pytest.approx([1.0, 1.0], abs=0.03)
    assert verdict.damping_share[1] == pytest.approx(1.0, abs=0.03)
    assert np.isnan(verdict.damping_share[0])
    assert (verdict.least_interaction[:2] >= -1e-6).all()


@pytest.mark.slow
def test_hands_lean_where_they_pushed_most() -> None:
    trial = trial_of("five_bar_sphere")
    (leaning, _), (moving, time) = trial._hands()
    assert moving is trial.scene
    assert time == pytest.approx(2.5)
    hand = leaning.mechanisms[0].hand
    assert hand is not None
    assert hand.motions == (None, None)
    assert hand.rest != trial.scene.mechanisms[0].hand.rest


CORNER = """{type: general,
    storages: [{type: spring, stiffness: 1000, lower: null, upper: 0.03}, {type: spring, stiffness: 500, upper: null},
               {type: mass, mass: 1}],
    gain: [[1, 0], [0, 1], [0, 0]], %s}"""
DAMPED = "dissipators: [{type: damper, viscous: 8, beside: 0}, {type: damper, viscous: 2, coulomb: 0.1, beside: 1}]"
ROOM = "{type: anisotropic_spring, stiffness: [[900, 300], [300, 400]], centre: [0, 0]%s}"


@pytest.mark.slow
@pytest.mark.parametrize(
    "network",
    [
        ROOM % "",
        CORNER % DAMPED,
        ROOM % ", damping: [[4, 0], [0, 2]]",
        CORNER % "",
    ],
)
def test_a_network_of_several_springs_passes_until_the_rig_cannot_render_it(network: str) -> None:
    trial = trial_of("xy_box", f"groups.0.network={network}")
    verdict = trial.verdict(np.array([1000.0, 2e6]), np.array([8.0, 0.0]))
    assert verdict.passed.tolist() == [True, False]
    assert verdict.stiffness_share[0] == pytest.approx(1.0, abs=0.05)
    assert verdict.damping_share[0] == pytest.approx(1.0, abs=0.03)


def test_an_anisotropic_spring_keeps_its_shape() -> None:
    scene = load_scene(CONFIGS / "xy_box.yaml", [f"groups.0.network={ROOM % ', damping: [[4, 0], [0, 2]]'}"])
    given: Any = scene.groups[0].network.parameters
    scale = network_scale(given, "anisotropic_spring")
    changed: Any = scale.with_values(2.0 * scale.stiffness, 1.0)
    assert scale.stiffness == pytest.approx(650.0 + np.hypot(250.0, 300.0))  # the larger eigenvalue
    assert np.array(changed.stiffness) == pytest.approx(2.0 * np.array(given.stiffness))
    assert np.array(changed.damping) == pytest.approx(np.diag([1.0, 0.5]))
    bare: Any = network_scale(given.model_copy(update={"damping": None}), "anisotropic_spring").with_values(100.0, 5.0)
    assert np.array(bare.damping) == pytest.approx(0.05 * np.array(bare.stiffness))


@pytest.mark.parametrize(("dissipators", "viscous"), [("", [10.0, 5.0]), (DAMPED, [10.0, 2.5])])
def test_a_general_network_keeps_what_no_port_moves(dissipators: str, viscous: list[float]) -> None:
    scene = load_scene(CONFIGS / "xy_box.yaml", [f"groups.0.network={CORNER % dissipators}"])
    given: Any = scene.groups[0].network.parameters
    changed: Any = network_scale(given, "general").with_values(2000.0, 10.0)
    assert [getattr(storage, "stiffness", None) for storage in changed.storages] == [2000.0, 1000.0, None]
    assert changed.storages[0].lower is None
    assert changed.storages[2] is given.storages[2]
    assert [damper.viscous for damper in changed.dissipators] == pytest.approx(viscous)
    pasted = yaml.safe_dump({"type": "general", **changed.model_dump(mode="json", exclude_unset=True)})
    again = load_scene(CONFIGS / "xy_box.yaml", [f"groups.0.network={pasted}"])
    assert again.groups[0].network.parameters == changed


def test_what_cannot_be_designed_is_said() -> None:
    mass = "{type: general, storages: [{type: mass, mass: 1}], gain: [[1, 0]]}"
    with pytest.raises(InputError, match="'general' has no spring at its ports"):
        trial_of("xy_box", f"groups.0.network={mass}")
    with pytest.raises(InputError, match="stiffness 0 in every direction"):
        trial_of("xy_box", "groups.0.network={type: anisotropic_spring, stiffness: [[0, 0], [0, 0]], centre: [0, 0]}")


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.campaign_for("five_bar_sphere")
@pytest.mark.parametrize("name", ["xy_box", "five_bar_sphere"])
def test_the_network_that_is_designed_is_a_scene(name: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["design", str(CONFIGS / f"{name}.yaml"), "--engine", "python", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    pasted = yaml.safe_load(result["yaml"])["groups"][0]
    assert result["stiffness_rendered"] == pytest.approx(1.0, abs=0.05)
    assert result["damping_rendered"] == (pytest.approx(1.0, abs=0.05) if result["damping"] else None)
    scene = load_scene(CONFIGS / f"{name}.yaml", [f"groups.0.network={yaml.safe_dump(pasted['network'])}"])
    verdict = NetworkTrial(scene, 0.05, "python").verdict(
        np.array([result["stiffness"]]), np.array([result["damping"]])
    )
    assert verdict.passed.all()

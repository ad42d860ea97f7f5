"""Scenes and sweeps that several tests share."""

from pathlib import Path

import pytest

from canhaptic.scene.load import load_scene

REPOSITORY = Path(__file__).resolve().parents[3]
DEMO = str(REPOSITORY / "configs" / "demo.yaml")
VARY = ["environment.stiffness=1e2:1e4:log:8", "bus.rate=100,1000", "environment.damping=0,5"]
TWO_AXES = f"""\
bus: {{interface: virtual, rate: 200 Hz, rpdo: event}}
axes:
  - {{name: left, node_id: 1, eds: {REPOSITORY}/eds/cia402_servo.eds, unit: m, counts_per_unit: 1e6,
     rated_torque: 10, torque_limit: 20}}
  - {{name: right, node_id: 2, eds: {REPOSITORY}/eds/cia402_servo.eds, unit: m, counts_per_unit: 1e6,
     rated_torque: 10, torque_limit: 20, environment: {{stiffness: 50}}}}
environment: {{type: spring_damper_wall, stiffness: 100, damping: 1}}
passivity: {{algorithm: unprotected}}
simulation:
  seed: 7
  plant: {{mass: 0.25, damping: 0.1}}
  user: {{stiffness: 60, damping: 5, motion: {{amplitude: 0.1, frequency: 2}}}}
  axes: {{right: {{plant: {{mass: 0.5}}}}}}
"""


def content(folder):
    """Returns every file of a sweep."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def demo():
    return load_scene(DEMO)


@pytest.fixture
def two_axes(tmp_path):
    (tmp_path / "two.yaml").write_text(TWO_AXES)
    return lambda *overrides: load_scene(tmp_path / "two.yaml", overrides)

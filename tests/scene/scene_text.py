"""A small valid scene for tests, as text, with pieces to replace."""

from pathlib import Path

import pytest

from canhaptic.errors import SceneError
from canhaptic.scene.load import load_scene

Replacement = tuple[str, str]

REPOSITORY = Path(__file__).resolve().parents[2]
SHIPPED_EDS = REPOSITORY / "eds" / "cia402_servo.eds"

SCENE = """\
duration: 1 s
bus: {interface: virtual, rate: 1 kHz, rpdo: event}
axes:
  - name: handle
    node_id: 1
    eds: cia402_servo.eds
    unit: m
    counts_per_unit: 1e6
    rated_torque: 10 N
    torque_limit: 20 N
environment:
  type: spring_damper_wall
  stiffness: 100 N/m
  damping: 10
passivity: {algorithm: unprotected}
simulation:
  plant: {mass: 0.25, damping: 0.1}
  user: {stiffness: 60, damping: 5, motion: {amplitude: 0.1, frequency: 0.5}}
"""

SECOND_AXIS = """\
  - name: knob
    node_id: 2
    eds: cia402_servo.eds
    unit: rad
    counts_per_unit: 65536
    rated_torque: 1 N*m
    torque_limit: 2 N*m
"""


def scene_file(folder: Path, *replacements: tuple[str, str]) -> Path:
    """Writes the scene with pieces of its text replaced; every piece must be there."""
    text = SCENE
    for old, new in replacements:
        assert old in text, old
        text = text.replace(old, new, 1)
    path = folder / "scene.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def faults(folder: Path, *replacements: Replacement, overrides: tuple[str, ...] = ()) -> list[str]:
    """Returns the faults with the folder cut off: `scene.yaml:line:column: ...`."""
    path = scene_file(folder, *replacements)
    with pytest.raises(SceneError) as caught:
        load_scene(path, overrides)
    return [line.replace(f"{folder}/", "") for line in caught.value.faults]

"""The rates that docs/passivity_guide.md says fit 1 Mbit/s are those that the bus budget lets pass, and no others."""

import re

import pytest

from canhaptic.errors import SceneConflictError
from canhaptic.scene.load import scene_from_text
from tests.docs.documents import ROOT

GUIDE = (ROOT / "docs" / "passivity_guide.md").read_text(encoding="utf-8")
DEMO = (ROOT / "configs" / "demo.yaml").read_text(encoding="utf-8")


def load(axes: int, rate: float) -> None:
    """Loads the demo with several axes at a rate [Hz]."""
    before, name, behind = DEMO.partition("  - name: handle\n")
    axis = re.match(r"(?:    .*\n|\n)+", behind)
    assert axis
    each = "".join(f"  - name: axis{i}\n{axis[0].replace('node_id: 1', f'node_id: {i}')}" for i in range(1, axes + 1))
    text = f"{before}{each}{behind[axis.end() :]}"
    scene = scene_from_text(text, str(ROOT / "configs" / "demo.yaml"), [f"bus.rate={rate:g}"])
    assert len(scene.axes) == axes
    assert name


@pytest.mark.parametrize(("axes", "rate"), [(1, 1400.0), (2, 1000.0), (3, 770.0)])
def test_the_guide_names_the_rates_that_fit(axes: int, rate: float) -> None:
    said = {1: "one axis runs at 1.4 kHz", 2: "two at 1 kHz", 3: "three at 770 Hz"}
    assert said[axes] in " ".join(GUIDE.split())
    load(axes, rate)
    with pytest.raises(SceneConflictError, match="the cycle does not fit the bus"):
        load(axes, 1.02 * rate)

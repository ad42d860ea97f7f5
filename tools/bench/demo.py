"""The demo, as it is shipped and with several axes: what most benchmarks run."""

from pathlib import Path
from typing import Any

import yaml

from canhaptic.scene.load import scene_from_text
from canhaptic.scene.models import Scene

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"


def demo_of(axes: int, rate: float, enable_delay: float = 0.0) -> Scene:
    """Returns the demo with so many axes, all alike.

    Args:
        axes: How many.
        rate: Of the SYNC [Hz].
        enable_delay: What each drive takes to enable [s].
    """
    document: dict[str, Any] = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    [first] = document["axes"]
    document["axes"] = [{**first, "name": f"axis{n}", "node_id": n} for n in range(1, axes + 1)]
    document["bus"]["rate"] = rate
    drive = document["simulation"]["drive"]
    drive["objects"] = {f"{index:#06x}": value for index, value in drive["objects"].items()}
    drive["enable_delay"] = enable_delay
    return scene_from_text(yaml.safe_dump(document), str(CONFIG))

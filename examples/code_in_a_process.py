"""Own code in a process of its own: a law that stalls for 5 s costs its own torques, and not one SYNC of the rig."""

import tempfile
from pathlib import Path

import canhaptic

DEMO = Path(__file__).resolve().parents[1] / "configs" / "demo.yaml"
LAW = """
import time
from typing import Annotated
from canhaptic import Environment
from canhaptic.extending import quantity

CALLS = []

class Dreamer(Environment):
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0)] = 300.0

    def effort(self, state: float) -> float:
        CALLS.append(state)
        if len(CALLS) == 4000:
            time.sleep(5.0)  # as a model does that is loaded, or a garbage collection
        return self.stiffness * state
"""
WALL = {"type": "dreamer.py:Dreamer", "stiffness": 300.0, "damping": 1.0, "side": "below", "position": -0.02}


def main(folder: Path) -> None:
    """Run at the pace of a real rig until the law is late for a tenth of a second; say what the rig noticed of it."""
    (folder / "dreamer.py").write_text(LAW)
    (folder / "scene.yaml").write_text(DEMO.read_text())
    overrides = [f"environment={WALL}", "code_runs_in=process", "late_holds=20", "bus.rate=200 Hz"]
    scene = canhaptic.load_scene(folder / "scene.yaml", overrides, allow_code=True)
    with canhaptic.build(scene, "real") as experiment:
        try:
            canhaptic.run(experiment.cycle, 2000)
        except canhaptic.RigError as error:
            print(f"{type(error).__name__}: {error}")
        code, rig = experiment.code, experiment.rig
        print(
            f"{experiment.cycle.cycles} cycles, {rig.skipped_syncs} SYNCs skipped; {code.late} holds without an answer"
        )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        main(Path(temporary))

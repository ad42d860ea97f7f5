"""A wall of your own, in six lines: write its force, and its name into the table."""

import sys
from pathlib import Path
from typing import Annotated

import canhaptic
from canhaptic import Environment
from canhaptic.extending import ENVIRONMENTS, quantity

CONFIGS = Path(__file__).resolve().parents[1] / "configs"


class StiffCentre(Environment):
    """A spring that gets stiffer on both sides of its centre."""

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e6)] = 200.0

    def effort(self, state: float) -> float:
        """Returns the force [N] at a distance [m] from the centre."""
        return self.stiffness * state + 1e5 * state**3


if __name__ == "__main__":
    sys.modules["own_wall"] = sys.modules["__main__"]
    ENVIRONMENTS["stiff_centre"] = "own_wall:StiffCentre"
    wall = {"type": "stiff_centre", "stiffness": "300 N/m", "damping": 1.0}
    result = canhaptic.simulate(CONFIGS / "demo.yaml", {"environment": wall}, duration=2.0)
    print(result.account["handle"])

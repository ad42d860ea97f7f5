"""A hand of your own: a grip that is startled once."""

from pathlib import Path

import canhaptic
from canhaptic.extending import OwnHand

CONFIGS = Path(__file__).resolve().parents[1] / "configs"


class Startled(OwnHand):
    """A grip that pulls away for a fifth of a second."""

    def force(self, time: float, position: float, velocity: float) -> float:
        """Returns the force on the handle [N]."""
        return 8.0 if 1.3 < time < 1.5 else 0.0


if __name__ == "__main__":
    from dataclasses import replace

    scene = canhaptic.load_scene(CONFIGS / "demo.yaml")
    [axis] = scene.axes
    assert axis.simulation is not None
    hand = Startled(**axis.simulation.user.model_dump()) if axis.simulation.user else Startled(stiffness=60.0)
    startled = replace(scene, axes=(replace(axis, simulation=replace(axis.simulation, user=hand)),))
    calm, shocked = (canhaptic.simulate(one, duration=2.0) for one in (scene, startled))
    for name, result in (("calm", calm), ("startled", shocked)):
        port = result.account["handle"]
        print(f"{name:9} out {port.energy_out:.5f} J, least sum {port.least_interaction:.2e} J, passive {port.passive}")
    calm.plot(shocked).savefig("startled.png")

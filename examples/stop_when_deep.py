"""Run the cycle yourself and stop it by your own rule."""

from pathlib import Path

from canhaptic import build, load_scene, run

CONFIGS = Path(__file__).resolve().parents[1] / "configs"

scene = load_scene(CONFIGS / "demo.yaml")
with build(scene) as experiment:
    plant = experiment.plants[0]
    run(experiment.cycle, cycles=10_000, stop_requested=lambda: plant.position < -0.08)
    print(f"stopped after {experiment.cycle.cycles} cycles at {1e3 * plant.position:.2f} mm")
    print(f"energy taken in: {experiment.cycle.ledgers[0].summary().energy_in:.5f} J")

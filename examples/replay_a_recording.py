"""Compare today's master with recorded frames: it must send every frame as recorded."""

from pathlib import Path

from canhaptic import build, load_scene, replay_bus_log, run

CONFIGS = Path(__file__).resolve().parents[1] / "configs"

scene = load_scene(CONFIGS / "demo.yaml")
with build(scene, bus_log="recorded.log") as experiment:
    run(experiment.cycle, cycles=1000)
result = replay_bus_log("recorded.log", scene)
print(f"{result['status']}: {result['frames']['compared']} frames compared, {result['speed']:.1f} times real time")

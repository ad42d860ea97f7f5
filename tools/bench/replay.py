"""How many times faster than it took is a recording replayed?"""

import contextlib
import io
import tempfile
from pathlib import Path
from time import perf_counter

from canhaptic.cli.main import main as canhaptic
from canhaptic.replay import replay_bus_log
from canhaptic.scene.load import load_scene
from tools.bench.demo import CONFIG
from tools.bench.report import Row, publish

DURATION = 60.0
REPEATS = 3
TARGET = 5.0


def main() -> None:
    """Records a minute of the demo, replays it, and publishes the ratio of recorded time to wall time."""
    factors = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "minute.log"
        words = ["run", str(CONFIG), "--pace", "free", "--duration", str(DURATION), "--bus-log", str(path), "--json"]
        with contextlib.redirect_stdout(io.StringIO()):
            canhaptic(words)
        scene = load_scene(CONFIG)
        for _ in range(REPEATS):
            begin = perf_counter()
            result = replay_bus_log(path, scene)
            factors.append(DURATION / (perf_counter() - begin))
            if result["status"] != "identical":
                raise SystemExit(f"the replay differs: {result}")
    best = max(factors)
    rows = [
        Row("replay of 60 s, best of 3", best, "x real time", target=f">= {TARGET:g}", met=best >= TARGET),
        Row("replay of 60 s, worst of 3", min(factors), "x real time"),
    ]
    publish("replay", rows, ["canhaptic", "python-can", "canopen"])


if __name__ == "__main__":
    main()

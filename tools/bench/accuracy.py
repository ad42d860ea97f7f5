"""How many seconds of the processor does `canhaptic accuracy` take on each shipped scene, and what does it leave out?

Each scene is studied in a process of its own, with the default budget. A scene that was measured is kept, so that a
later call goes on from there.
"""

import json
import resource
import subprocess
import sys
from pathlib import Path

from canhaptic.files import shipped
from tools.bench.report import Row, kept_folder, publish

MOST = 20.0  # [s] of the processor
NOT_STUDIED = ("drives", "interfaces")
KEPT = "accuracy_scenes"


def scenes() -> dict[str, Path]:
    """Returns every shipped scene by its name."""
    folder = shipped("configs")
    found = {path.relative_to(folder): path for path in sorted(folder.rglob("*.yaml"))}
    return {name.with_suffix("").as_posix(): path for name, path in found.items() if name.parts[0] not in NOT_STUDIED}


def studied(path: Path) -> tuple[float, str]:
    """Returns the seconds of the processor of one study, and what it left out, or why there is none."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = [sys.executable, "-m", "canhaptic", "accuracy", str(path), "--json"]
    done = subprocess.run(words, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    said = json.loads(done.stdout)
    refused = done.stderr.strip().rpartition("\n")[2].replace(str(path), path.name)
    note = refused if done.returncode else "; ".join(said.get("remarks") or ())
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, note


def kept(name: str, path: Path) -> tuple[float, str]:
    """Returns what `studied` gives, from an earlier call if there is one."""
    place = kept_folder() / KEPT / f"{name.replace('/', '_')}.json"
    if not place.is_file():
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(json.dumps(studied(path)), encoding="utf-8")
    seconds, note = json.loads(place.read_text(encoding="utf-8"))
    return seconds, note


def main() -> None:
    """Studies every scene, and publishes the table."""
    found = {name: kept(name, path) for name, path in scenes().items()}
    rows = [
        Row(name, round(seconds, 2), "s", target=f"<= {MOST:g} s", met=seconds <= MOST, note=note)
        for name, (seconds, note) in found.items()
    ]
    most = max(rows, key=lambda row: row.value)
    whole = Row("the longest of all scenes", most.value, "s", target=f"<= {MOST:g} s", met=most.met, note=most.row)
    publish("accuracy", [whole, Row("scenes", len(rows), ""), *rows], ["canhaptic", "numpy", "scipy", "numba"])


if __name__ == "__main__":
    main()

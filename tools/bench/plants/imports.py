"""What importing the plant with all effects costs beyond NumPy, each in a fresh interpreter."""

import subprocess
import sys
from functools import partial

from tools.bench.report import Row, interleave

REPEATS = 9
ALL = (
    "import importlib; from canhaptic.sim.plant.effects import EFFECTS; import canhaptic.sim.plant.plant; "
    "[importlib.import_module(entry.partition(':')[0]) for entry in EFFECTS.values()]"
)


def import_rows() -> list[Row]:
    """Returns the time of the import beyond NumPy's, and the part of it that is pydantic's own."""
    scripts = {"numpy": "import numpy", "pydantic": "import numpy, pydantic; pydantic.BaseModel", "all": ALL}
    runs = {
        name: partial(subprocess.run, [sys.executable, "-c", script], check=True) for name, script in scripts.items()
    }
    least = {name: min(times) * 1e3 for name, times in interleave(runs, REPEATS).items()}
    beyond, pydantic = least["all"] - least["numpy"], least["pydantic"] - least["numpy"]
    note = f"pydantic alone is {pydantic:.0f} ms of it; canhaptic {beyond - pydantic:.0f} ms"
    row = "import of plant and all effects, beyond NumPy"
    return [Row(row, beyond, "ms", "NumPy", least["numpy"], None, "<= 60", beyond <= 60.0, note)]

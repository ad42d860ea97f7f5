"""Which drives can serve, by their dictionaries, and does a whole simulated run pass for each that can?

Reads every EDS and DCF of eds/ and of the folder in CANHAPTIC_VENDOR_EDS; each that can serve is brought up, and
rendered to, by the configuration that `canhaptic new --simulate` writes for it, profile included.
"""

import os
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from canhaptic.cli.check_eds import survey_of
from canhaptic.cycle import run
from canhaptic.drive.survey import Suitability, Survey
from canhaptic.errors import CanHapticError
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.scene.scene_text import starter_scene
from tools.bench.report import out_folder, write_result

ROOT = Path(__file__).resolve().parents[2]
OBJECTS = (0x1016, 0x6007, 0x6071, 0x6072, 0x6074, 0x6075, 0x6076, 0x6077, 0x608F, 0x6091, 0x60C2, 0x6502)
"""What a drive for cyclic torque may have."""
CYCLES = 1500


@dataclass(frozen=True, slots=True)
class Verdict:
    """One dictionary."""

    file: str
    drive: str
    verdict: str
    reasons: list[str]  # why it cannot serve
    missing: list[str]  # objects
    profile: str  # empty for none
    map: list[str]
    read_back: str
    load_at_1khz: float | None  # part of the bus, 0 to 1
    run: str  # "passed", "not run", or what went wrong
    energy_in: float  # [J]
    believed_error: float  # largest |believed - true| [J]


def judge(path: Path) -> Verdict:
    """Returns what a dictionary says, and how a whole run with it ended."""
    found, profile = survey_of(path)
    outcome, energy_in, error = "not run", 0.0, 0.0
    if found.suitability is not Suitability.UNFIT:
        outcome, energy_in, error = simulate(starter_scene(found, simulate=True, drive=profile))
    load = next((row.periodic_load for row in found.loads if row.rate == 1000.0), None)
    return Verdict(
        path.name,
        f"{found.vendor} {found.product}".strip(),
        found.suitability.value,
        [row.item for row in found.reasons],
        [f"{index:#06x}" for index in OBJECTS if index not in found.dictionary],
        profile or "",
        planned(found),
        "" if found.axis_map is None else found.axis_map.read_back,
        load,
        outcome,
        energy_in,
        error,
    )


def planned(found: Survey) -> list[str]:
    """Returns the PDOs that would be used."""
    if found.axis_map is None:
        return []
    plans = (found.axis_map.rpdo, *found.axis_map.tpdos)
    return [f"{plan.name} {'written' if plan.is_written else 'fixed'} {plan.length} B" for plan in plans]


def simulate(text: str) -> tuple[str, float, float]:
    """Returns how a run of the scene ended, the energy that came in and the largest error of the account [J]."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.yaml"
        path.write_text(text, encoding="utf-8")
        try:
            with build(load_scene(path)) as experiment:
                run(experiment.cycle, CYCLES)
                [ledger], judge_of_truth = experiment.cycle.ledgers, experiment.cycle.judge
                error = 0.0 if judge_of_truth is None else judge_of_truth.believed_error[0]
                energy_in = ledger.summary().energy_in
        except CanHapticError as error_raised:
            return f"{type(error_raised).__name__}: {error_raised}", 0.0, 0.0
    return ("passed" if energy_in > 0.0 else "no contact"), energy_in, error


def table_of(verdicts: list[Verdict]) -> Table:
    """Returns the table."""
    table = Table(box=box.SIMPLE_HEAD)
    for column in ("dictionary", "verdict", "objects missing", "map", "read-back", "at 1 kHz", "simulated run"):
        table.add_column(column, overflow="fold")
    for v in verdicts:
        verdict = v.verdict if not v.reasons else f"{v.verdict}: {', '.join(v.reasons)}"
        load = "" if v.load_at_1khz is None else f"{100 * v.load_at_1khz:.1f} %"
        outcome = v.run if v.run != "passed" else f"passed, {v.energy_in:.3g} J in, error {v.believed_error:.1g} J"
        table.add_row(v.file, verdict, ", ".join(v.missing), "; ".join(v.map), v.read_back, load, outcome)
    return table


def main() -> int:
    """Judges every dictionary, prints the table and writes it down; returns 1 when a drive that can serve did not."""
    named = os.environ.get("CANHAPTIC_VENDOR_EDS")
    vendors = [Path(named)] if named and Path(named).is_dir() else []
    found = [path for folder in vendors for kind in ("*.eds", "*.dcf") for path in folder.glob(kind)]
    files = [*sorted((ROOT / "eds").glob("*.eds")), *sorted(found)]
    verdicts = [judge(path) for path in files]
    Console(width=180).print(table_of(verdicts))
    if not vendors:
        print(
            f"no vendor dictionaries: CANHAPTIC_VENDOR_EDS is {named!r}, expected their folder; "
            "the result file is left as it is"
        )
        return 0
    rows = [asdict(verdict) for verdict in verdicts]
    write_result(out_folder() / "dictionaries.json", ["canhaptic", "canopen"], {"rows": rows})
    return 0 if all(verdict.run in ("passed", "not run") for verdict in verdicts) else 1


if __name__ == "__main__":
    sys.exit(main())

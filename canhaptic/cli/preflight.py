"""`canhaptic check --host CONFIG`: check the interfaces of a scene, as `run` does; time its drives."""

import argparse
from typing import Final

from canhaptic.cli.options import scene_of
from canhaptic.drive.can.round_trip import RoundTrip, measure_round_trip
from canhaptic.host.findings import PreflightFinding
from canhaptic.host.socketcan_state import preflight
from canhaptic.scene.build import build
from canhaptic.scene.models import Scene
from canhaptic.view.run_lines import make_console
from canhaptic.view.table import Cell, Styled, Table
from canhaptic.view.terminal import write_json

_REFUSED: Final = 1
_COLOURS: Final = {"well": "green", "note": "yellow", "refused": "red"}
_WORDS: Final = {"refused": "run refused"}


def execute(arguments: argparse.Namespace) -> int:
    """Print the state of each interface; return 1 if a run would be refused, else 0."""
    scene = scene_of(arguments)
    findings = preflight(scene.loaded_buses)
    is_refused = any(finding.severity == "refused" for finding in findings)
    trips = _round_trips(scene) if arguments.bus and not is_refused else []
    if arguments.json:
        verdict = "refused" if is_refused else "well"
        interfaces, times = [f._asdict() for f in findings], [{**t._asdict(), "fits": t.fits} for t in trips]
        more = {"round_trips": times} if arguments.bus else {}
        write_json({"status": "ok", "verdict": verdict, "interfaces": interfaces, **more})
    else:
        _print(findings, [bus.parameters.interface for bus in scene.buses])
        if trips:
            make_console().print(
                Table(
                    "100 reads by SDO", ("axis", "least", "median", "largest", "", ""), [_row(trip) for trip in trips]
                )
            )
    return _REFUSED if is_refused else 0


def _round_trips(scene: Scene) -> list[RoundTrip]:
    with build(scene) as experiment:
        return [measure_round_trip(drive) for drive in experiment.rig.drives]


def _row(trip: RoundTrip) -> list[Cell]:
    times = [f"{1e3 * time:.3f} ms" for time in (trip.least, trip.median, trip.largest)]
    return [trip.axis, *times, Styled("fits", "green") if trip.fits else Styled("too slow", "yellow"), trip.advice()]


def _print(findings: list[PreflightFinding], interfaces: list[str]) -> None:
    console = make_console()
    if not findings:
        console.print(f"nothing to check: bus.interface is {', '.join(interfaces)}, not socketcan or a line of its own")
        return
    rows = [
        (f.interface, f.item, Styled(_WORDS.get(f.severity, f.severity), _COLOURS[f.severity]), f.seen, f.text)
        for f in findings
    ]
    console.print(Table("interfaces", ("interface", "item", "", "found", "what to do"), rows))

"""`canhaptic preflight CONFIG`: check the SocketCAN interfaces of a scene, as `run` does before it begins."""

import argparse
from typing import Final

from canhaptic.cli.options import scene_of
from canhaptic.host.socketcan_state import PreflightFinding, preflight
from canhaptic.view.run_lines import make_console
from canhaptic.view.table import Styled, Table
from canhaptic.view.terminal import write_json

_REFUSED: Final = 1
_COLOURS: Final = {"well": "green", "note": "yellow", "refused": "red"}
_WORDS: Final = {"refused": "run refused"}


def execute(arguments: argparse.Namespace) -> int:
    """Print the state of each interface; return 1 if a run would be refused, else 0."""
    scene = scene_of(arguments)
    findings = preflight(scene.loaded_buses)
    is_refused = any(finding.severity == "refused" for finding in findings)
    if arguments.json:
        verdict = "refused" if is_refused else "well"
        write_json({"status": "ok", "verdict": verdict, "interfaces": [f._asdict() for f in findings]})
    else:
        _print(findings, [bus.parameters.interface for bus in scene.buses])
    return _REFUSED if is_refused else 0


def _print(findings: list[PreflightFinding], interfaces: list[str]) -> None:
    console = make_console()
    if not findings:
        console.print(f"nothing to check: bus.interface is {', '.join(interfaces)}, not socketcan")
        return
    rows = [
        (f.interface, f.item, Styled(_WORDS.get(f.severity, f.severity), _COLOURS[f.severity]), f.seen, f.text)
        for f in findings
    ]
    console.print(Table("SocketCAN", ("interface", "item", "", "found", "what to do"), rows))

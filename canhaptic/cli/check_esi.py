"""`canhaptic check-eds FILE.xml`: the same for an EtherCAT drive, from its ESI or the content of its EEPROM (SII)."""

import argparse
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from canhaptic.canopen.esi import esi_devices
from canhaptic.canopen.sii import is_sii, read_sii
from canhaptic.drive.ethercat.esi_survey import DeviceVerdict, Judgement, choose, judge
from canhaptic.errors import InputError
from canhaptic.view.run_lines import make_console
from canhaptic.view.terminal import write_json

_COLOURS: Final = {
    Judgement.FIT: "green", Judgement.CONDITIONAL: "yellow", Judgement.ASK: "yellow", Judgement.UNFIT: "red"
}  # fmt: skip
_USABLE: Final = (Judgement.FIT, Judgement.CONDITIONAL)


def execute(arguments: argparse.Namespace) -> int:
    """Print the verdict with its reasons; return 1 unless the drive is usable, if under conditions."""
    path, revision = arguments.file, arguments.revision
    if arguments.display is not None or arguments.force_object is not None:
        raise InputError("--display, --force-object: only for an EDS or DCF; leave them out for an EtherCAT drive")
    devices = (read_sii(path),) if is_sii(path) else esi_devices(path)
    verdicts = [judge(path, device) for device in devices]
    chosen = choose(verdicts, path, revision)
    if arguments.json:
        rows = [_as_json(of) for of in verdicts]
        write_json({"status": "ok", "file": str(path), **_as_json(chosen), "devices": rows})
    else:
        _print(make_console(), path, chosen, verdicts)
    return 0 if chosen.judgement in _USABLE else 1


def _as_json(of: DeviceVerdict) -> dict[str, Any]:
    vendor, product, revision = of.device.identity
    return {
        "verdict": of.judgement.value, "reasons": list(of.reasons), "conditions": list(of.conditions),
        "process_data": of.process_data, "notes": list(of.notes),
        "device": {"title": of.device.title, "vendor_id": vendor, "product_code": product, "revision": revision},
    }  # fmt: skip


def _print(console: Console, path: Path, chosen: DeviceVerdict, verdicts: list[DeviceVerdict]) -> None:
    vendor, product, revision = chosen.device.identity
    place = f"vendor {vendor:#x}, product {product:#x}, revision {revision:#x}"
    console.print(f"{path}: {chosen.device.title or 'no name in this file'} ({place})", markup=False, style="bold")
    console.print(f"[bold {_COLOURS[chosen.judgement]}]{chosen.judgement.value}[/]")
    for text in chosen.reasons or chosen.conditions:
        console.print(f"  {text}", markup=False)
    if chosen.process_data:
        console.print(f"process data: {chosen.process_data}", markup=False)
    for text in chosen.notes:
        console.print(f"  {text}", markup=False, style="dim")
    for of in verdicts:
        if of is not chosen:
            what = f"product {of.device.identity[1]:#x}, revision {of.device.identity[2]:#x}: {of.judgement.value}"
            console.print(f"also in this file: {what}{''.join(f'; {text}' for text in of.reasons)}", markup=False)
    console.print("a file proves neither the scale of the torque nor its hold: canhaptic commission", style="dim")

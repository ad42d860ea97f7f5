"""`canhaptic check-eds FILE`: whether the drive of an EDS or DCF can be used, and the keys to configure by hand."""

import argparse
from itertools import groupby
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError
from rich.console import Console

from canhaptic.canopen.eds import DriveDictionary, read_dictionary
from canhaptic.cli.options import is_of_line
from canhaptic.drive.can.pdo_map import AxisMap, PdoPlan
from canhaptic.drive.profile.fitness import Verdict
from canhaptic.drive.profile.motion_parameters import Mode
from canhaptic.drive.survey import MOST_AXES, Suitability, Survey, display_of, survey, unconfigured_axis
from canhaptic.errors import InputError
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.models import status_text
from canhaptic.scene.profiles import profile_of_vendor, profile_values
from canhaptic.scene.scene_text import starter_scene
from canhaptic.view.run_lines import make_console
from canhaptic.view.table import Cell, Styled, Table
from canhaptic.view.terminal import write_json

_COLOURS: Final = {Suitability.FIT: "green", Suitability.CONDITIONAL: "yellow", Suitability.UNFIT: "red"}
WORDS: Final = {
    Verdict.FIT: Styled("ok", "green"),
    Verdict.UNKNOWN: Styled("condition", "yellow"),
    Verdict.REFUSED: Styled("not usable", "red"),
}
"""Displayed word of each verdict on an object."""
_UNFIT: Final = 1
_FEW: Final = 3


def execute(arguments: argparse.Namespace) -> int:
    """Print the verdict with its reasons; return 1 if the drive is not usable."""
    if is_of_line(arguments.file):
        from canhaptic.cli.check_esi import execute as execute_esi  # loads EtherCAT

        return execute_esi(arguments)
    if arguments.revision is not None:
        raise InputError("--revision: only for an ESI, which may describe several; leave it out")
    found, profile = survey_of(arguments.file, arguments.display, arguments.force_object)
    if arguments.json:
        write_json({**_as_json(found), "profile": profile, "statuses": _statuses(found, profile)})
    else:
        _print(make_console(), found, profile, full=arguments.full)
    return _UNFIT if found.suitability is Suitability.UNFIT else 0


def _statuses(found: Survey, profile: str | None) -> str:
    """Return in one line whether a scene made by `canhaptic new` for this drive is ready, simulated and on hardware."""
    if found.suitability is Suitability.UNFIT:
        return f"Simulation: {Suitability.UNFIT.value}. Hardware: {Suitability.UNFIT.value}"
    return status_text(scene_from_text(starter_scene(found, simulate=True, drive=profile), str(found.axis.eds)))


def survey_of(path: Path, mode: Mode | None = None, force_object: str | None = None) -> tuple[Survey, str | None]:
    """Judge the drive of a dictionary; return the findings, and the name of the drive profile used (or None).

    Args:
        path: EDS or DCF of the drive.
        mode: Mode of an admittance display; None: cyclic torque.
        force_object: Object with the measured force of a display; None: a known analog input of the drive if there is
            one, else a separate sensor node.

    Raises:
        DictionaryError: The file cannot be read.
        InputError: `force_object` does not name an object, or was given for cyclic torque.
    """
    axis = unconfigured_axis(path)
    dictionary = read_dictionary(path, axis.node_id)
    if force_object is not None and mode is None:
        raise InputError("--force-object: only for an admittance display; add --display velocity or position")
    try:
        values = {} if mode is None else {"admittance": display_of(dictionary, mode, force_object)}
    except ValidationError as error:
        raise InputError(f"--force-object: {error.errors()[0]['msg'].removeprefix('Value error, ')}") from error
    found = survey(dictionary, unconfigured_axis(path, **values))
    name = profile_of_vendor(found.vendor_id)
    if name is None or found.suitability is Suitability.UNFIT:
        return found, None
    return survey(dictionary, unconfigured_axis(path, **profile_values(name), **values)), name


def warnings_of(found: Survey) -> list[str]:
    """Return what of the dictionary could not be read: sections, whose objects no scene may use, and entries."""
    given = found.dictionary
    if not isinstance(given, DriveDictionary):
        return []
    sections = [
        f"{text}; it is left out, since nothing here uses it" for text in dict.fromkeys(given.left_out.values())
    ]
    return [text.removeprefix(f"{found.axis.eds}: ") for text in (*sections, *given.unread)]


def print_warnings(console: Console, found: Survey, *, full: bool = False) -> None:
    """Print what of the dictionary could not be read; without `full` the first few."""
    texts = warnings_of(found)
    for text in texts if full else texts[:_FEW]:
        console.print(f"  warning: {text}", markup=False, style="yellow")
    if len(texts) > _FEW and not full:
        console.print(f"  {len(texts) - _FEW} warnings more: canhaptic check-eds --full", markup=False, style="yellow")


def _as_json(found: Survey) -> dict[str, Any]:
    return {
        "status": "ok",
        "file": str(found.axis.eds),
        "verdict": found.suitability.value,
        "reasons": [f"{row.item}: {row.text}" for row in found.reasons],
        "conditions": [f"{row.item}: {row.text}" for row in found.conditions],
        "warnings": warnings_of(found),
        "device": {
            "vendor": found.vendor,
            "product": found.product,
            "vendor_id": found.vendor_id,
            "product_code": found.product_code,
            "bitrates": list(found.bitrates),
        },
        "objects": [{**row._asdict(), "verdict": row.verdict.value} for row in found.rows],
        "configure": {key.key: key.reason for key in found.manual},
        "map": None if found.axis_map is None else _map_as_json(found.axis_map),
        "bus": {"bitrate": found.bitrate, "rates": [load._asdict() for load in found.loads]},
    }


def _map_as_json(axis_map: AxisMap) -> dict[str, Any]:
    def pdo(plan: PdoPlan) -> dict[str, Any]:
        return {
            "name": plan.name,
            "cob_id": f"{plan.cob_id:#05x}",
            "written": plan.is_written,
            "bytes": plan.length,
            "entries": [str(entry) for entry in plan.entries],
        }

    return {"rpdo": pdo(axis_map.rpdo), "tpdos": [pdo(t) for t in axis_map.tpdos], "read_back": axis_map.read_back}


# --- the tables ---------------------------------------------------------------------------------------------------


def _print(console: Console, found: Survey, profile: str | None, *, full: bool) -> None:
    vendor = "" if found.product.startswith(found.vendor) else found.vendor
    name = " ".join(part for part in (vendor, found.product) if part) or "no product name in this file"
    console.print(f"{found.axis.eds}: {name}", markup=False, style="bold")
    if profile is not None:
        console.print(f"judged with the shipped profile of this vendor (drive: {profile})", markup=False)
    console.print(f"[bold {_COLOURS[found.suitability]}]{found.suitability.value}[/]")
    console.print(_statuses(found, profile), markup=False)
    for row in found.reasons or found.conditions:
        console.print(f"  {row.item}: {row.text}", markup=False, soft_wrap=False)
    print_warnings(console, found, full=full)
    if not full:
        _print_brief(console, found)
        return
    console.print()
    console.print(_object_table(found))
    if found.axis_map is not None:
        console.print(_map_table(found.axis_map))
        console.print(_load_table(found))
    if not found.reasons:
        console.print(Table("to be configured by hand, under axes", ("key", "why"), found.manual))


def _print_brief(console: Console, found: Survey) -> None:
    """Print the rates that fit and the keys to configure, one line each."""
    if found.axis_map is not None and not found.reasons:
        read = ", ".join(str(entry) for plan in found.axis_map.tpdos for entry in plan.entries)
        console.print(f"read in each cycle (index:subindex/bits): {read}", markup=False)
        fitting = [f"{load.rate:g} Hz" for load in found.loads if load.fits]
        rates = ", ".join(fitting) or "none"
        bus = f"usual rates that fit the bus, one axis at {found.bitrate / 1000:g} kbit/s"
        console.print(f"{bus}: {rates}", markup=False)
    if not found.reasons and found.manual:
        console.print("values to set under `axes:` that only your rig or the drive's manual can give:", markup=False)
        console.print(f"  {', '.join(key.key for key in found.manual)}", markup=False)
        console.print("`canhaptic new` writes a scene with every value to set, and where to find it", markup=False)
    console.print("[dim]every object, map and rate, and why a key is needed: --full[/]")


def _object_table(found: Survey) -> Table:
    rows: list[list[Cell]] = []
    for heading, below in groupby(found.rows, lambda row: str(row.group)):
        rows.append([])
        shown = heading
        for row in below:
            text = "see below" if row.item == "map" and row.verdict is Verdict.FIT else row.text
            rows.append([shown, row.item, WORDS[row.verdict], row.stated, text])
            shown = ""
    return Table("what the dictionary states", ("", "object", "", "stated", "meaning"), rows)


def _map_table(axis_map: AxisMap) -> Table:
    rows = [
        [
            plan.name, f"{plan.cob_id:#05x}", plan.length, "written" if plan.is_written else "fixed",
            ", ".join(str(entry) for entry in plan.entries),
        ]
        for plan in (axis_map.rpdo, *axis_map.tpdos)
    ]  # fmt: skip
    return Table("map that would be used (node 1)", ("PDO", "COB-ID", "bytes", "mapping", "objects"), rows)


def _load_table(found: Survey) -> Table:
    rows = [
        [
            f"{load.rate:g} Hz", f"{100 * load.periodic_load:.1f} %", f"{load.worst_cycle * 1e6:.0f} us",
            f"{1e6 / load.rate:.0f} us", Styled("fits", "green") if load.fits else Styled("does not fit", "red"),
            f"{MOST_AXES} or more" if load.axes == MOST_AXES else load.axes,
        ]
        for load in found.loads
    ]  # fmt: skip
    title = f"bus at {found.bitrate / 1000:g} kbit/s, one axis"
    return Table(title, ("rate", "periodic load", "worst cycle", "of", "", "axes that fit"), rows)

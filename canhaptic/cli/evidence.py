"""`canhaptic evidence CONFIG --out FOLDER`: test a drive, and put the evidence into one folder.

The folder holds the scene and its dictionaries, the commissioning report, the logs of a dry run and of a run at a
tenth of the torque limit, the software versions, and a page to sign with the hash of every file.
"""

import argparse
import hashlib
import json
import platform
import re
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from canhaptic.cli.commission import dialogue_of, walk
from canhaptic.cli.long_command import check_list
from canhaptic.cli.options import scene_of
from canhaptic.commission.session import CommissioningLimits, Dialogue, Session
from canhaptic.errors import InputError
from canhaptic.host.stop_signal import StopSignal
from canhaptic.scene.build import build
from canhaptic.scene.buses import DICTIONARIES, kind_of
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene, require_no_guesses
from canhaptic.scene.overrides import split_override
from canhaptic.scene.scene_text import Change, edited_text
from canhaptic.view.terminal import note_file, write_file, write_note

_TENTH: Final = 0.1
_PACKAGES: Final = ("canhaptic", "python-can", "canopen", "numpy", "pydantic", "h5py")
_NAMES: Final = re.compile(r"(?im)^(FileName|CreatedBy|ModifiedBy|LastEDS|NodeName|NetworkName|Description)=.*$")
_SERIAL: Final = re.compile(r"(?ims)^(\[1018sub4\].*?^(?:ParameterValue|DefaultValue)=)[^\r\n]*")


def execute(arguments: argparse.Namespace) -> int:
    """Fill the folder; return 0, or 128 + n after signal n: nothing more is run, and there is no page to sign.

    Raises:
        InputError: The folder exists, values are still to be set, or a person declined a run.
        CanHapticError: A run failed; the folder keeps the records up to there.
    """
    scene, out = scene_of(arguments), arguments.out
    require_no_guesses(scene)
    dialogue = dialogue_of(scene, yes=arguments.yes)
    if out.exists():
        raise InputError(f"{out} already exists; name another folder")
    out.mkdir(parents=True)
    path = _copied(scene, out, anonymous=arguments.anonymous)
    limits = CommissioningLimits(travel=arguments.travel)
    with StopSignal() as stop:
        own = load_scene(path)
        session = Session(own, dialogue, limits, stop.requested)
        missing, error = walk(session, 1.0)
        _write_json(out / "commissioning.json", {**session.report.as_json(), "unfinished": missing})
        if error is not None:
            raise error
        if stop.requested():
            return _stopped(out, stop)
        if session.report.failed:
            text = f"{out}: the commissioning failed, so nothing was run: {'; '.join(missing)}"
            raise InputError(f"{text}; mend this with canhaptic commission, then choose a new folder")
        if not any(axis.parameters.causality.holds for axis in own.axes):
            _run(own, "dry_run", arguments, dialogue, stop)
        if stop.requested():
            return _stopped(out, stop)
        tenth = [f"axes.{n}.torque_limit={_TENTH * axis.parameters.torque_limit}" for n, axis in enumerate(own.axes)]
        tenth += [f"axes.{n}.limit_by_master=true" for n in range(len(own.axes))]  # below the drive's least value too
        _run(load_scene(path, tenth), "tenth", arguments, dialogue, stop)
        if stop.requested():
            return _stopped(out, stop)
    _write_json(out / "versions.json", _versions())
    rows = "\n".join(
        f"| {file.name} | {hashlib.sha256(file.read_bytes()).hexdigest()} |" for file in sorted(out.iterdir())
    )
    listed = "\n".join(f"- [{text[0]}] {text[2:]}" for text in check_list(own.run.confirmed))
    status = "simulated drive: evidence of the software alone" if own.simulated else "real drive"
    page = Path(__file__).with_suffix(".md").read_text(encoding="utf-8")
    write_file(out / "sign.md", page.format(rows=rows, check_list=listed, status=status))
    note_file("evidence", out)
    return 0


def _stopped(out: Path, stop: StopSignal) -> int:
    write_note(f"  stopped: the folder {out} is incomplete and has no page to sign; remove it and begin again")
    return stop.exit_status


def _copied(scene: Scene, out: Path, *, anonymous: bool) -> Path:
    """Copy the scene and its dictionaries into a folder; return the path of the copied scene."""
    changes: list[Change] = []
    for number, axis in enumerate(scene.axes):
        key, path = DICTIONARIES[kind_of(scene.bus_of(axis))], axis.parameters.dictionary_path
        name = f"drive{number}{Path(path.name.removesuffix('.gz')).suffix}"
        (out / name).write_bytes(_content(path, is_esi=key == "esi", anonymous=anonymous))
        changes.append(Change(("axes", str(number), key), name))
    overrides = [Change(*split_override(text)) for text in scene.overrides]
    text = edited_text(scene.text, [*overrides, *changes])
    if anonymous:
        text = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("#")) + "\n"
    write_file(out / "rig.yaml", text)
    return out / "rig.yaml"


def _content(path: Path, *, is_esi: bool, anonymous: bool) -> bytes:
    """Return the content of a dictionary, without the names in it if asked for."""
    if not anonymous:
        return path.read_bytes()
    if is_esi:
        from canhaptic.canopen.esi import without_names

        return without_names(path).encode()
    content = path.read_bytes().decode("latin-1")
    return _SERIAL.sub(r"\g<1>0", _NAMES.sub(lambda found: f"{found[1]}=", content)).encode("latin-1")


def _run(scene: Scene, name: str, arguments: argparse.Namespace, dialogue: Dialogue, stop: StopSignal) -> None:
    """Run a scene with both logs, and write its account."""
    out, duration, no_torque = arguments.out, arguments.duration, name == "dry_run"
    torque = "without torque" if no_torque else "at a tenth of torque_limit"
    if not dialogue.confirm(f"next: a run of {duration:g} s {torque}, with your hand on the handle. Start it?"):
        if stop.requested():
            return
        raise InputError(f"{name}: declined, so the folder {out} is incomplete; remove it and begin again")
    with build(scene, None, out / f"{name}.h5", out / f"{name}{_suffix(scene)}", no_torque=no_torque) as experiment:
        account, error = experiment.run_through(round(duration / scene.bus.sample_time), stop.requested)
        _write_json(out / f"{name}.json", account)
        if error is not None:
            raise error


def _suffix(scene: Scene) -> str:
    """Return the suffix of a bus log: text of CAN frames, or a capture of a line."""
    return ".log" if kind_of(scene.bus) == "can" else ".pcap"


def _write_json(path: Path, value: Any) -> None:
    write_file(path, json.dumps(value, indent=1, default=str, sort_keys=True) + "\n")


def _versions() -> dict[str, str]:
    """Return the versions of the software used; the name of the computer is left out."""
    found = {"python": platform.python_version(), "system": f"{platform.system()} {platform.release()}"}
    return found | {name: version(name) for name in _PACKAGES}

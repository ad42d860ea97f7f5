"""`canhaptic commission CONFIG`: from an untried drive to a measured configuration, step by step, zero torque first."""

import argparse
import json
import os
import select
import sys
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from canhaptic.cli.long_command import check_list
from canhaptic.cli.options import check_place, scene_of
from canhaptic.commission.admittance_tests import REQUIRED as OF_DISPLAYS
from canhaptic.commission.admittance_tests import commission_displays
from canhaptic.commission.sequence import REQUIRED as OF_TORQUES
from canhaptic.commission.sequence import commission
from canhaptic.commission.session import CommissioningLimits, Dialogue, Report, Session, Unattended
from canhaptic.errors import CanHapticError, InputError, StartStoppedError
from canhaptic.host.stop_signal import StopSignal, requested
from canhaptic.scene.models import CHECK_LIST, CheckItem, Scene
from canhaptic.scene.scene_text import Change, edited_scene
from canhaptic.view.run_lines import make_console
from canhaptic.view.terminal import failure, note_file, visible, write_failure, write_file, write_json, write_note

_TO_CORRECT: Final = 1  # exit status: the configuration differs from the rig, or the rig must not be used
_LOOK: Final = 0.05  # [s] between two looks for a signal
_LONGEST_LINE: Final = 4096  # bytes; a terminal hands over one line at a time
_YES: Final = ("y", "yes")


def execute(arguments: argparse.Namespace) -> int:
    """Take the rig through all steps.

    Returns 0 if every value agrees or was written, 1 if work remains, 128 + n after signal n.
    """
    scene = scene_of(arguments)
    limits = CommissioningLimits(torque=arguments.torque, travel=arguments.travel, speed=arguments.speed)
    place = _place(scene, arguments)
    dialogue = dialogue_of(scene, yes=arguments.yes)
    with StopSignal() as stop:
        session = Session(scene, dialogue, limits, stop.requested)
        missing, error = walk(session, arguments.duration)
        report, is_written = session.report, False
        confirmed: dict[CheckItem, str] = {} if scene.simulated or missing or error else _confirmed(dialogue)
        if stop.requested():
            missing.insert(0, "stopped")
        todo = _next_step(session, missing, error)
        if place is not None and report.values:
            try:
                changes = [Change(("confirmed", item), f'"{moment}"') for item, moment in confirmed.items()]
                _write(scene, [*report.changes(scene), *changes, *_mark(scene, todo)], place, arguments)
                is_written = True
            except CanHapticError as raised:
                error = error or raised
        _print(report, missing, error, place if is_written else None, arguments)
        write_note(_last_sentence(todo, place if is_written else None, arguments, is_right=not report.differs))
        if error is not None:
            return error.exit_status
        is_to_correct = report.failed or report.differs or place is not None
        return stop.exit_status or (_TO_CORRECT if todo or (is_to_correct and not is_written) else 0)


def _next_step(session: Session, missing: Sequence[str], error: CanHapticError | None) -> str:
    """Return what keeps the scene from being ready, and what to do about it; empty if nothing does."""
    if not missing and error is None:
        return ""
    if missing[:1] == ["stopped"]:
        return "stopped"
    return str(error or session.report.next_step(_steps_of(session.scene)[1]) or missing[0])


def _mark(scene: Scene, todo: str) -> list[Change]:
    """Return the change that marks a scene as unfinished, or takes the mark from one that had it."""
    if not todo:
        return [Change(("unfinished",), "null", "commissioned")] if scene.run.unfinished else []
    return [Change(("unfinished",), json.dumps(" ".join(todo.split()), ensure_ascii=False))]


def _last_sentence(todo: str, place: Path | None, arguments: argparse.Namespace, *, is_right: bool) -> str:
    """Return the one thing to do after a commissioning."""
    if todo:
        kept = "" if place is None else f"; what was found is in {place}, which is marked unfinished and is not run"
        return f"  To do: {todo}{kept}; then commission again"
    if place is not None:
        return f"  To do: canhaptic run {place}"
    found = "every value is right" if is_right else "some values differ"
    return f"  To do: {found}; --out FILE.yaml writes the scene with what was found, --in-place replaces it"


def walk(session: Session, duration: float) -> tuple[list[str], CanHapticError | None]:
    """Take the rig through all steps; return the missing or failed items, and the error that ended the session."""
    scene, error = session.scene, None
    take, required = _steps_of(scene)
    try:
        take(session, duration)
    except StartStoppedError:
        pass  # of a signal, which the caller sees too
    except CanHapticError as raised:
        error = raised
    names = [axis.parameters.name for axis in scene.axes]
    return session.report.unfinished(names, required), error


def _steps_of(scene: Scene) -> tuple[Callable[[Session, float], None], Sequence[str]]:
    """Return what takes a rig through its steps, and the items that must be verified for each axis."""
    if any(axis.parameters.causality.holds for axis in scene.axes):
        return (lambda session, _: commission_displays(session)), OF_DISPLAYS
    return commission, OF_TORQUES


def _place(scene: Scene, arguments: argparse.Namespace) -> Path | None:
    """Return the file for the scene, checked to be writable; None if no file was asked for.

    Raises:
        InputError: The file cannot be written, or the scene would have another meaning at that path.
    """
    place: Path | None = arguments.config if arguments.in_place else arguments.out
    if place is None:
        return None
    if arguments.in_place and not place.is_file():
        raise InputError(f"{place} is a scene of the package; name a file of your own with --out")
    new = _backup(place) if arguments.in_place else place
    check_place(place, force=True)
    check_place(new, force=True)
    if new.exists():
        raise InputError(f"{new} already exists; choose another name, or move it away first")
    edited_scene(scene, (), str(place), allow_code=arguments.allow_code)
    return place


def _backup(place: Path) -> Path:
    return place.with_name(f"{place.name}.bak")


def _confirmed(dialogue: Dialogue) -> dict[CheckItem, str]:
    """Ask for each item of the check list; return the time at which each was confirmed."""
    moment = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    confirmed = {item: moment for item, text in CHECK_LIST.items() if dialogue.confirm(f"check list: {text}?")}
    for text in check_list(confirmed):
        dialogue.tell(f"  {text}")
    return confirmed


def _write(scene: Scene, changes: Sequence[Change], place: Path, arguments: argparse.Namespace) -> None:
    """Write the scene with the measured values.

    Raises:
        InputError: The file cannot be written, or the edited scene would not yield the measured values.
    """
    text = edited_scene(scene, changes, str(place), allow_code=arguments.allow_code)
    if arguments.in_place:
        write_file(_backup(place), scene.text)
    elif place.exists():
        raise InputError(f"{place} was created in the meantime; choose another name")
    write_file(place, text)


def dialogue_of(scene: Scene, *, yes: bool) -> Dialogue:
    """Return the dialogue with a person at the terminal, or with `yes` one that agrees to everything.

    Raises:
        InputError: `yes` with a real drive, or there is no terminal.
    """
    if yes:
        if not scene.simulated:
            text = f"{scene.source}: --yes is for drives simulated in this process"
            raise InputError(f"{text}; for a real drive a person at the machine must answer")
        return Unattended(write_note)
    if not sys.stdin.isatty():
        raise InputError("a person must confirm every step, which needs a terminal; simulated drives also take --yes")
    return _Terminal()


class _Terminal:
    """Dialogue with a person at a terminal; questions go to standard error, so that the report can be redirected.

    Input typed before a question is discarded, so that consent to a torque is given after reading the question.
    """

    def __init__(self) -> None:
        self._input = sys.stdin.fileno()

    def tell(self, text: str) -> None:
        """Print what is being done."""
        write_note(text)

    def confirm(self, question: str) -> bool:
        """Return whether the person typed yes; anything else, and the end of the input, is no."""
        return self._ask(f"{question} [y/N] ").lower() in _YES

    def number(self, question: str, unit: str, truth: float | None) -> float | None:
        """Ask until the answer is a number or empty."""
        while text := self._ask(f"{question} [{unit}] "):
            try:
                return float(text.removesuffix(unit).strip())
            except ValueError:
                write_note(f"  got {text!r}, expected a number in {unit}, or nothing")
        return None

    def choose(self, question: str, answers: Sequence[str], truth: str) -> str:
        """Ask until one of the answers is typed; an empty line or the end of the input means the last of them."""
        while text := self._ask(f"{question} [{'/'.join(answers)}] ").lower():
            if text in answers:
                return text
        return answers[-1]

    def until_ready(self, text: str, cycles: int) -> Callable[[], bool]:
        """Return a function that reports, without waiting, whether Enter was pressed."""
        self._forget()
        write_note(text)

        def pressed() -> bool:
            if not select.select([self._input], [], [], 0.0)[0]:
                return False
            self._line()
            return True

        return pressed

    def _ask(self, prompt: str) -> str:
        self._forget()
        sys.stderr.write(visible(prompt))
        sys.stderr.flush()
        return self._line().strip()

    def _forget(self) -> None:
        import termios  # not on Windows

        termios.tcflush(self._input, termios.TCIFLUSH)

    def _line(self) -> str:
        """Read one line, unbuffered: `select` cannot see lines in Python's buffer; a signal is no answer."""
        while not select.select([self._input], [], [], _LOOK)[0]:
            if requested():
                return ""  # as at the end of the input
        return os.read(self._input, _LONGEST_LINE).decode(errors="replace")


def _print(
    report: Report, missing: list[str], error: CanHapticError | None, place: Path | None, arguments: argparse.Namespace
) -> None:
    """Print the findings, then the error if there is one, then the path of the written scene."""
    if arguments.json:
        result = {**report.as_json(), "unfinished": missing, "written": None if place is None else str(place)}
        write_json(result if error is None else {**failure(error), "result": result})
    else:
        console = make_console()
        console.print(report.table())
        if report.values:
            console.print(report.values_table("values found" if place is None else f"written to {place}"))
    if error is not None:
        write_failure(error)
    if place is not None:
        note_file("scene", place)
    elif arguments.out is not None or arguments.in_place:
        write_note("  nothing was found that could be written")
    for text in missing:
        write_note(f"    {text}")

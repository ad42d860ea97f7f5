"""`canhaptic commission CONFIG`: from an untried drive to a measured configuration, step by step, zero torque first."""

import argparse
import os
import select
import sys
from collections.abc import Callable
from typing import Final

from canhaptic.cli.arguments import check_place, scene_of
from canhaptic.cli.output import failure, write_failure, write_file, write_json, write_line, write_note
from canhaptic.cli.stop_signal import StopSignal
from canhaptic.commission.dialogue import Dialogue, Unattended
from canhaptic.commission.display_tests import commission_displays
from canhaptic.commission.findings import Report
from canhaptic.commission.laws import CommissioningLimits
from canhaptic.commission.sequence import commission
from canhaptic.commission.session import Session
from canhaptic.errors import CanHapticError, InputError
from canhaptic.scene.models import Scene
from canhaptic.view.energy_table import make_console

_TO_CORRECT: Final = 1  # exit status: the configuration differs from the rig, or the rig must not be used
_LONGEST_LINE: Final = 4096  # bytes; a terminal hands over one line at a time
_YES: Final = ("y", "yes")


def execute(arguments: argparse.Namespace) -> int:
    """Walks the steps; returns 0 when all agrees, 1 when something is to be corrected, 130 or 143 after a signal."""
    scene = scene_of(arguments)
    limits = CommissioningLimits(torque=arguments.torque, travel=arguments.travel, speed=arguments.speed)
    if arguments.out is not None:
        check_place(arguments.out)
    dialogue = _dialogue(scene, yes=arguments.yes)
    error: CanHapticError | None = None
    with StopSignal() as stop:
        session = Session(scene, dialogue, limits, stop.requested)
        try:
            if any(axis.parameters.admittance is not None for axis in scene.axes):
                commission_displays(session)
            else:
                commission(session, arguments.duration)
        except CanHapticError as raised:
            error = raised
        _print(session.report, error, arguments)
        if error is not None:
            return error.exit_status
        return stop.exit_status or (_TO_CORRECT if session.report.failed or session.report.differs else 0)


def _dialogue(scene: Scene, *, yes: bool) -> Dialogue:
    if yes:
        if not scene.simulated:
            raise InputError(
                f"{scene.source}: --yes is for drives that are simulated in this process; at a real one somebody must "
                "stand at the machine and answer"
            )
        return Unattended(write_note)
    if not sys.stdin.isatty():
        raise InputError("commission asks before every torque and needs a terminal; --yes is for simulated drives")
    return _Terminal()


class _Terminal:
    """A person at a terminal; questions go to standard error, so that the report can be redirected.

    What was typed before a question was asked is no answer to it: consent to a torque needs the question read first.
    """

    def __init__(self) -> None:
        self._input = sys.stdin.fileno()

    def tell(self, text: str) -> None:
        """Says what happens now."""
        write_note(text)

    def confirm(self, question: str) -> bool:
        """Returns whether the person typed yes; anything else, and the end of the input, is no."""
        return self._ask(f"{question} [y/N] ").lower() in _YES

    def number(self, question: str, unit: str, truth: float | None) -> float | None:
        """Asks until the answer is a number or nothing."""
        while text := self._ask(f"{question} [{unit}] "):
            try:
                return float(text.removesuffix(unit).strip())
            except ValueError:
                write_note(f"  got {text!r}, expected a number in {unit}, or nothing")
        return None

    def until_ready(self, text: str, cycles: int) -> Callable[[], bool]:
        """Returns what looks, without waiting, whether Enter was pressed."""
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
        sys.stderr.write(prompt)
        sys.stderr.flush()
        return self._line().strip()

    def _forget(self) -> None:
        import termios  # not on Windows

        termios.tcflush(self._input, termios.TCIFLUSH)

    def _line(self) -> str:
        """Returns one line as typed; past Python's buffer, in which lines would wait unseen."""
        return os.read(self._input, _LONGEST_LINE).decode(errors="replace")


def _print(report: Report, error: CanHapticError | None, arguments: argparse.Namespace) -> None:
    """Prints what was found, also before an error, and the values to paste."""
    snippet = report.snippet()
    if arguments.json:
        result = {**report.as_json(), "snippet": snippet}
        write_json(result if error is None else {**failure(error), "result": result})
    else:
        make_console().print(report.table())
        if snippet:
            write_line("values to paste:\n")
            write_line(snippet)
    if error is not None:
        write_failure(error)
    if arguments.out is not None:
        write_file(arguments.out, snippet)

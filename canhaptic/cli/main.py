"""Entry point of the `canhaptic` command: imports the subcommand's module and turns errors into exit statuses.

0 success   1 a check or comparison failed   2 bad input   3 drive or link fault   128 + n ended by signal n

Ctrl-C ends a command that moves no drive at once, also within a library call that delays signals.
"""

import argparse
import errno
import gc
import importlib
import os
import signal
import sys
import threading
import warnings
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Final, Self

from canhaptic.cli.options import add_arguments, table
from canhaptic.errors import CanHapticError, InputError, OverrideWarning
from canhaptic.registry import nearest
from canhaptic.view.terminal import failure, leave_closed_terminal, write_failure, write_json, write_note

COMMANDS: Final = {name: of["about"] for name, of in table().items() if "heading" in of}
"""Subcommand -> its description; old names are left out."""
_BROKEN_PIPE: Final = 1
INTERRUPTED: Final = 130
_PATIENCE: Final = 0.7
"""Time after Ctrl-C for a command to end by itself and print partial results [s]."""
_SIGINT: Final = bytes([signal.SIGINT])
_END: Final = b"\0"
_LINE: Final = "canhaptic: interrupted\n"
_COMPLETION: Final = "_ARGCOMPLETE"
"""Environment variable that a shell sets to ask for completions."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status.

    `options.toml` lists the arguments of a subcommand. Once they are valid, the module with the subcommand's name is
    imported; its `execute` takes them and returns the exit status.
    """
    try:
        words = list(sys.argv[1:] if arguments is None else arguments)
        typed = next((word for word in words if not word.startswith("-")), "")
        words, name = in_mode(words, typed)
        if table().get(name, {}).get("stops_in_order"):
            return _run(words, name)
        with PromptEnd():
            return _run(words, name)
    except KeyboardInterrupt:
        say_interrupted()
        return INTERRUPTED


def in_mode(words: list[str], name: str) -> tuple[list[str], str]:
    """Return the words with the section of `options.toml` in place of the command, and the section's name."""
    for flag, section in table().get(name, {}).get("modes", {}).items():
        if any(word == flag or word.startswith(f"{flag}=") for word in words):
            place, keeps = words.index(name), flag in table()[section]["arguments"]
            rest = [word for word in words[place + 1 :] if keeps or word != flag]
            return [*words[:place], section, *rest], section
    if "now" in table().get(name, {}):
        write_note(f"canhaptic: {name} is now: canhaptic {table()[name]['now']}; the old name works in this release")
    return words, name


def _run(words: list[str], name: str) -> int:
    parser = argparse.ArgumentParser(
        prog="canhaptic", description="Passive haptic rendering on CiA 402 servo drives.", epilog=_overview(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--version", action=_ShowVersion)
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    completes = _COMPLETION in os.environ
    for known, of in table().items():
        subparser = subparsers.add_parser(
            known, prog=f"canhaptic {of.get('now', known)}", description=f"{of['about'][:1].upper()}{of['about'][1:]}.",
            epilog=f"Example: {of['example']}    Exit status: {_exits(of)}.",
        )  # fmt: skip
        if known == name or (completes and known in COMMANDS):
            add_arguments(known, subparser)
    if completes:
        _complete(parser)
    if not words:
        parser.print_help()
        return 0
    if name and name not in table():
        parser.error(f"{name}: no such command{nearest(name, COMMANDS, 2) or '; see --help'}")
    with warnings.catch_warnings():
        _show_warnings()
        arguments, unknown = parser.parse_known_args(words)
        if unknown:
            parser.error(f"unrecognized arguments: {' '.join(unknown)}{_meant(unknown[0], name)}")
        for flag in table().get(name, {}).get("modes", {}):  # an abbreviation would run the command without the mode
            if getattr(arguments, flag.lstrip("-").replace("-", "_")):
                parser.error(f"{flag}: write the option in full")
        return _execute(arguments)


def _exits(of: dict[str, Any]) -> str:
    return "; ".join(filter(None, ("0 success", of.get("exits", ""), "2 bad input")))


def _overview() -> str:
    """Return the commands below their headings, with an example of each."""
    lines = list[str]()
    for heading in dict.fromkeys(table()[name]["heading"] for name in COMMANDS):
        lines += [f"{heading}:"]
        for name, of in table().items():
            if of.get("heading") == heading:
                lines += [f"  {name:<11} {of['about']}", f"{'':<16}{of['example']}"]
    return "\n".join(
        [*lines, "", "exit status: 0 success, 1 a check failed, 2 bad input, 3 drive or link, 128 + n signal n"]
    )


def _meant(unknown: str, command: str) -> str:
    """Return a hint to the option that an unknown one probably meant, to end a message; "" if none is similar."""
    from canhaptic.control.passivity import ALGORITHMS

    options = table()[command]["arguments"]
    if (algorithm := unknown.lstrip("-")) in ALGORITHMS and "--set" in options:
        return f"; did you mean --set passivity={algorithm}?"
    return nearest(unknown, [option for option in options if option.startswith("--")])


def _complete(parser: argparse.ArgumentParser) -> None:
    """Print completions for the shell and end the process; do nothing without argcomplete."""
    try:
        from argcomplete import autocomplete
        from argcomplete.completers import BaseCompleter, FilesCompleter
    except ImportError:
        return
    from canhaptic.files import scene_names

    class ScenesAndFiles(BaseCompleter):
        def __call__(self, *, prefix: str, action: argparse.Action, **more: Any) -> list[str]:
            names = scene_names() if action.dest == "config" else []
            return [name for name in names if name.startswith(prefix)] + list(FilesCompleter()(prefix))

    autocomplete(parser, default_completer=ScenesAndFiles())


def _show_warnings() -> None:
    """Show warnings about a scene as notes of one line, and others as Python does."""
    before = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, OverrideWarning):
            write_note(f"canhaptic: warning: {message}")
        else:
            before(message, category, *where, **more)

    warnings.showwarning = show


class _ShowVersion(argparse.Action):
    """Option that prints the version; the version is looked up only then, because that takes as long as `--help`."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="show program's version number and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        """Print the version and end."""
        from importlib.metadata import version

        parser.exit(0, f"canhaptic {version('canhaptic')}\n")


def _imported(name: str) -> Any:
    """Import a module with garbage collection off, which saves a tenth of the start-up time."""
    if name in sys.modules:
        return sys.modules[name]
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        return importlib.import_module(name)
    finally:
        gc.freeze()
        if was_enabled:
            gc.enable()


def _execute(arguments: argparse.Namespace) -> int:
    try:
        package = "canhaptic.lab.commands" if table()[arguments.command].get("laboratory") else "canhaptic.cli"
        command = _imported(f"{package}.{arguments.command.replace('-', '_')}")
        status: int = command.execute(arguments)
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader left; nothing to report to it
        return _BROKEN_PIPE
    except CanHapticError as raised:
        error = raised
    except MemoryError:
        error = CanHapticError("out of memory; end other programs, or raise the limit (ulimit -v)")
    except OSError as raised:
        if raised.errno == errno.EIO and raised.filename is None:  # the terminal was closed
            leave_closed_terminal()
            return _BROKEN_PIPE
        if raised.errno in (errno.EMFILE, errno.ENFILE):
            error = CanHapticError("no more files can be opened; end other programs, or raise the limit (ulimit -n)")
        elif raised.filename is None:
            raise
        else:
            error = InputError(f"{raised.filename}: {raised.strerror}; name another file")
    if getattr(arguments, "json", False):
        write_json(failure(error))
    write_failure(error)
    return error.exit_status


def say_interrupted() -> None:
    """Print the final line of a command after Ctrl-C."""
    sys.stderr.write(_LINE)
    sys.stderr.flush()


class PromptEnd:
    """Within the block, Ctrl-C ends the process after 0.7 s if it has not ended by then.

    Python handles a signal only between two of its own instructions, so a compiler that takes seconds for one call
    would delay it. The signal number is also written into a pipe, and a thread waits there. Files being written at
    that moment stay incomplete, as after a kill. Commands that move a drive must not use it: they stop in order.
    """

    def __init__(self) -> None:
        self._ended = threading.Event()
        self._read = self._write = self._before = -1

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._read, self._write = os.pipe()
            os.set_blocking(self._write, False)
            self._before = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
            threading.Thread(target=self._watch, name="interrupt", daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._write < 0:
            return
        signal.set_wakeup_fd(self._before, warn_on_full_buffer=False)
        os.write(self._write, _END)
        self._ended.set()

    def _watch(self) -> None:
        byte = b""
        while byte not in (_END, _SIGINT):
            byte = os.read(self._read, 1)
        if not self._ended.wait(_PATIENCE if byte == _SIGINT else None):
            os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, _LINE.encode())
            if util := sys.modules.get("multiprocessing.util"):
                util._run_finalizers(0)  # noqa: SLF001 (removes a pool's semaphores, else a warning follows)
            os._exit(INTERRUPTED)
        os.close(self._read)
        os.close(self._write)

"""Entry of the `canhaptic` command: finds the subcommand, imports its module, turns errors into exit statuses.

0 success   1 a check or comparison failed   2 bad input   3 drive or link fault   130 SIGINT   143 SIGTERM
"""

import argparse
import difflib
import gc
import importlib
import os
import sys
import warnings
from collections.abc import Sequence
from typing import Any, Final

from canhaptic.cli.interrupt import INTERRUPTED, PromptEnd, say_interrupted
from canhaptic.cli.output import print_failure, write_note
from canhaptic.errors import CanHapticError, InputError, OverrideWarning

COMMANDS: Final = {
    "configs": "list the scenes that come with the package, or copy them to change",
    "check-eds": "say whether the drive of an EDS or DCF can serve, and what its configuration must bring",
    "new": "write a commented configuration to start from, for the drive of an EDS or DCF",
    "check": "say what a scene would do: configuration, bus load, fitness of the drives, stability",
    "preflight": "check the SocketCAN interfaces of a scene: bit rate, state, queue, restart after bus-off",
    "commission": "walk a new rig from zero torque to a measured configuration, asking before every torque",
    "run": "run a scene: bring the drives up, render, print the energy account",
    "evidence": "fill a folder that shows how a drive did: commissioning, dry run, a run at a tenth, a page to sign",
    "scope": "show an energy log in a browser while it is written",
    "inspect": "read an energy log: account, checks, comparison, pictures, export, recomputation",
    "replay": "replay a recorded bus against today's master and controllers, and compare every frame they send",
    "decode": "name every frame of a bus log",
    "touch": "touch a simulated scene with the pointer in a browser, unprotected and protected at once",
    "design": "find the stiffest and most damped wall that a rig renders, as lines for its scene",
    "compare": "compare every passivity algorithm on one scene with the continuous environment",
    "accuracy": "show what accuracy costs in time: methods, settings, effects, rate, delay, resolution; with advice",
    "sweep": "judge many scenes that differ in some keys, on one core, several or a cluster",
    "map": "draw a sweep: largest wall stiffness, rendered share, and the borders of theory",
    "warm": "compile the loops of a scene, so that the first sweep finds them, as in an image of a CI",
    "arena": "compare every passivity algorithm, and your own, on scenes that are hard, as one page",
    "home": "let one drive find its zero by its own homing mode, asking before it moves",
    "lss": "give one node on the bus its node ID (LSS), asking before it is stored",
    "drive": "simulate the drives of a scene alone, on a bus that another process uses",
    "schema": "print the JSON Schema of scene files, for editors",
}
"""In the order of a user: a scene, its check, a rig, a run, its log; then studies."""
_LABORATORY: Final = frozenset({"accuracy", "arena", "compare", "design", "map", "sweep", "touch", "warm"})
"""Commands in `canhaptic.lab.commands`; the others are in `canhaptic.cli`."""
_STOP_IN_ORDER: Final = frozenset({"commission", "evidence", "home", "run", "drive", "scope", "touch"})
"""Commands that take Ctrl-C as the operator's stop, and need time for it."""
_BROKEN_PIPE: Final = 1
_COMPLETION: Final = "_ARGCOMPLETE"
"""Environment variable that a shell sets which asks for completions."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status.

    `add_options` declares the arguments of a subcommand. The module with its name has `execute`, which takes them
    and returns the exit status; it is imported once the arguments are right.
    """
    try:
        words = list(sys.argv[1:] if arguments is None else arguments)
        name = next((word for word in words if not word.startswith("-")), "")
        if name in _STOP_IN_ORDER:
            return _run(words, name)
        with PromptEnd():
            return _run(words, name)
    except KeyboardInterrupt:
        say_interrupted()
        return INTERRUPTED


def _run(words: list[str], name: str) -> int:
    parser = argparse.ArgumentParser(prog="canhaptic", description="Passive haptic rendering on CiA 402 servo drives.")
    parser.add_argument("--version", action=_ShowVersion)
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    completes = _COMPLETION in os.environ
    for known, text in COMMANDS.items():
        subparser = subparsers.add_parser(known, help=text, description=f"{text[:1].upper()}{text[1:]}.")
        if known == name or completes:
            add_options(known, subparser)
    if completes:
        _complete(parser)
    if not words:
        parser.print_help()
        return 0
    if name and name not in COMMANDS:
        near = difflib.get_close_matches(name, COMMANDS, n=2)
        parser.error(f"{name}: no such command; " + (f"did you mean {' or '.join(near)}?" if near else "see --help"))
    with warnings.catch_warnings():
        _show_warnings()
        return _execute(parser.parse_args(words))


def _complete(parser: argparse.ArgumentParser) -> None:
    """Answer the shell that completes a line, and end; nothing without argcomplete."""
    try:
        from argcomplete import autocomplete
        from argcomplete.completers import BaseCompleter, FilesCompleter
    except ImportError:
        return
    from canhaptic.input_file import scene_names

    class ScenesAndFiles(BaseCompleter):
        def __call__(self, *, prefix: str, action: argparse.Action, **more: Any) -> list[str]:
            names = scene_names() if action.dest == "config" else []
            return [name for name in names if name.startswith(prefix)] + list(FilesCompleter()(prefix))

    autocomplete(parser, default_completer=ScenesAndFiles())


def add_options(name: str, parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of a subcommand."""
    module = "canhaptic.lab.commands.lab_options" if name in _LABORATORY else "canhaptic.cli.options"
    importlib.import_module(module).OPTIONS[name](parser)


def _show_warnings() -> None:
    """Show a warning about a scene as one line, like every note; others as Python does."""
    before = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, OverrideWarning):
            write_note(f"canhaptic: warning: {message}")
        else:
            before(message, category, *where, **more)

    warnings.showwarning = show


class _ShowVersion(argparse.Action):
    """Looks the version up on demand: the search takes as long as the rest of `--help`."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="show program's version number and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        """Print the version and end."""
        from importlib.metadata import version

        parser.exit(0, f"canhaptic {version('canhaptic')}\n")


def _imported(name: str) -> Any:
    """Import a module without garbage collection, which would cost a tenth of the start."""
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
        package = "canhaptic.lab.commands" if arguments.command in _LABORATORY else "canhaptic.cli"
        command = _imported(f"{package}.{arguments.command.replace('-', '_')}")
        status: int = command.execute(arguments)
        sys.stdout.flush()
        return status
    except CanHapticError as error:
        print_failure(error, as_json=getattr(arguments, "json", False))
        return error.exit_status
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader left; nothing to report to it
        return _BROKEN_PIPE
    except OSError as error:
        if error.filename is None:
            raise
        refused = InputError(f"{error.filename}: {error.strerror}; name another file")
        print_failure(refused, as_json=getattr(arguments, "json", False))
        return refused.exit_status

"""Entry of the `canhaptic` command: finds the subcommand, imports its module, turns errors into exit statuses.

0 well   1 a check or comparison failed   2 bad input   3 drive or link fault   130 SIGINT   143 SIGTERM
"""

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Final

from canhaptic.cli.output import print_failure
from canhaptic.errors import CanHapticError

_COMMANDS: Final = {
    "commission": "walk a new rig from zero torque to a measured configuration, asking before every torque",
    "run": "run a scene: bring the drives up, render, print the energy account",
    "check": "say what a scene would do: configuration, bus load, fitness of the drives, stability",
    "check-eds": "say whether the drive of an EDS or DCF can serve, and what its configuration must bring",
    "new": "write a commented configuration to start from, for the drive of an EDS or DCF",
    "preflight": "look at the SocketCAN interfaces of a scene: bit rate, state, queue, what follows a bus-off",
    "drive": "simulate the drives of a scene alone, on a bus that another process uses",
    "compare": "compare every passivity algorithm on one scene with the continuous environment",
    "accuracy": "show what accuracy costs in time: methods, settings, effects, rate, delay, resolution; with advice",
    "sweep": "judge many scenes that differ in some keys, on one core, several or a cluster",
    "map": "draw a sweep: how stiff a wall may be, what is left of it, and where theory draws the line",
    "design": "find the stiffest and most damped wall that a rig renders, as lines for its scene",
    "inspect": "read an energy log: account, checks, comparison, pictures, export, recomputation",
    "replay": "replay a recorded bus against today's master and controllers, and compare every frame they send",
    "scope": "show an energy log in a browser while it is written",
    "decode": "name every frame of a bus log",
    "configs": "list the scenes that come with the package, or copy them to change",
    "schema": "print the JSON Schema of scene files, for editors",
}
_INTERRUPTED: Final = 130
_BROKEN_PIPE: Final = 1


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line and returns the exit status.

    A subcommand is the module of `canhaptic.cli` of its name: `add_arguments` declares its arguments, `execute` takes
    them and returns the exit status.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    name = next((word for word in words if not word.startswith("-")), "")
    parser = argparse.ArgumentParser(prog="canhaptic", description="Passive haptic rendering on CiA 402 servo drives.")
    parser.add_argument("--version", action="version", version=f"canhaptic {version('canhaptic')}")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for known, text in _COMMANDS.items():
        subparser = subparsers.add_parser(known, help=text, description=f"{text[:1].upper()}{text[1:]}.")
        if known == name:  # only what is used is imported
            command = importlib.import_module(f"canhaptic.cli.{known.replace('-', '_')}")
            command.add_arguments(subparser)
            subparser.set_defaults(execute=command.execute)
    return _execute(parser.parse_args(words))


def _execute(arguments: argparse.Namespace) -> int:
    try:
        status: int = arguments.execute(arguments)
        sys.stdout.flush()
        return status
    except CanHapticError as error:
        print_failure(error, as_json=getattr(arguments, "json", False))
        return error.exit_status
    except KeyboardInterrupt:
        return _INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader left; nothing to report to it
        return _BROKEN_PIPE

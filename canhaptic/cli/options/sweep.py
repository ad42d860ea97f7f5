"""Arguments of `canhaptic sweep`."""

import argparse
from pathlib import Path

from canhaptic.cli.arguments import add_json, add_scene, names, seconds


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `sweep`."""
    add_scene(parser)
    parser.add_argument(
        "--vary",
        metavar="KEY=VALUES",
        action="append",
        default=[],
        help="LOW:HIGH:N, LOW:HIGH:log:N or A,B,C of any key of the scene, as in environment.stiffness=1e2:1e6:log:40 "
        "(every axis) or axes.0.torque_limit=5,10; repeatable",
    )
    parser.add_argument("--controllers", metavar="A,B,...", type=names, default=[], help="judge each scene under these")
    parser.add_argument(
        "--sample", metavar="lhs:N", type=_samples, default=0, help="N points of a Latin hypercube, no grid"
    )
    parser.add_argument("--seed", metavar="N", type=_count, default=0, help="of the hypercube")
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--duration", metavar="S", type=seconds, help="of every scene [s]; by default the scene's")
    length.add_argument("--cycles", metavar="N", type=_count, help="SYNCs of every scene, whatever its rate")
    parser.add_argument(
        "--metrics",
        metavar="A,B,...",
        type=names,
        help="fewer are faster; by default all that need no continuous run beside each scene; a wrong name lists all",
    )
    parser.add_argument(
        "--engine", choices=("auto", "numba", "python"), default="auto", help="of scenes that fit a batch"
    )
    parser.add_argument("--beyond-bus", action="store_true", help="judge rates that the bus could not carry, too")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", metavar="N", type=_count, default=1, help="processes on this machine")
    where.add_argument("--dask", metavar="ADDRESS", help="scheduler of a Dask cluster, as in tcp://10.0.0.5:8786")
    parser.add_argument("--chunk", metavar="N", type=_count, help="scenes that are finished together")
    parser.add_argument("--out", metavar="FILE.h5", type=Path, help="results; each chunk is there once it is finished")
    again = parser.add_mutually_exclusive_group()
    again.add_argument("--resume", action="store_true", help="go on with FILE.h5 where it was stopped or killed")
    again.add_argument("--force", action="store_true", help="replace FILE.h5")
    add_json(parser)


def _samples(text: str) -> int:
    kind, _, number = text.partition(":")
    if kind != "lhs" or not number.isdigit() or not 1 <= int(number) <= 100_000_000:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected lhs:N with N from 1 to 10^8")
    return int(number)


def _count(text: str) -> int:
    if not (text.isascii() and text.isdigit()) or not 0 <= int(text) <= 1_000_000_000:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected a whole number from 0 to 10^9")
    return int(text)

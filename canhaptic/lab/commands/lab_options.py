"""The arguments of the laboratory's subcommands, as `canhaptic.cli.options` declares those of the others."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Final

from canhaptic.cli.options import (
    PORT,
    add_allow_code,
    add_json,
    add_scene,
    budget,
    delays,
    length,
    names,
    rate,
    rates,
    samples,
    seconds,
    whole,
)

_COUNT, _SOME, _WORKERS = whole(0, 10**9), whole(1, 10**9), whole(1, 1024)
BUDGET: Final = 4.0
"""Time for timings [s]; as `lab.studies.accuracy.study.DEFAULT_BUDGET`, which is imported when the study begins."""
TOLERANCE, MARGIN = 0.05, 0.2
"""As in `lab.studies.design.wall`, which is imported when the search begins."""
JUDGEMENTS: Final = ("stable", "passive", "margin", "settled", "covered")
"""As in `lab.studies.map`, which is imported when a map is drawn."""


def _accuracy(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `accuracy`."""
    add_scene(parser)
    parser.add_argument(
        "--tolerance",
        metavar="X",
        type=length,
        help="largest error of the position, as in '1 um' or 1e-6 [m or rad]; by default a tenth of an encoder count",
    )
    parser.add_argument("--axis", metavar="NAME", help="which axis or group; by default the first")
    parser.add_argument(
        "--duration",
        metavar="S",
        type=seconds,
        help="length of the comparison [s]; by default until the second contact, 4000 sample times at most",
    )
    parser.add_argument(
        "--budget", metavar="S", type=budget, default=BUDGET, help="time to spend on timing [s]; 0: none"
    )
    parser.add_argument(
        "--engine", choices=("auto", "numba", "python"), default="auto", help="engine of the loops; numba compiles"
    )
    parser.add_argument("--tables", action="store_true", help="show every row, not the answer only")
    parser.add_argument(
        "--beyond-bus", action="store_true", help="study a rate that the bus cannot carry; no run could keep it"
    )
    parser.add_argument("--png", metavar="FILE", type=Path, help="picture of the study (.png, .svg, .pdf)")
    parser.add_argument("--html", metavar="FILE", type=Path, help="self-contained page: advice, picture, tables")
    parser.add_argument("--markdown", metavar="FILE", type=Path, help="the tables as Markdown")
    add_json(parser)


def _arena(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `arena`."""
    parser.add_argument("--scenes", metavar="A,B,...", type=names, help="names of configs/hard, or files; default: all")
    parser.add_argument("--algorithms", metavar="A,B,...", type=names, help="algorithms to compare (default: all)")
    parser.add_argument(
        "--entry", metavar="FILE.py:CLASS", action="append", default=[], help="an algorithm of your own; repeatable"
    )
    parser.add_argument("--rates", metavar="HZ,HZ,...", type=rates, help="by default 100, 300, 1000, 3000, 8000")
    parser.add_argument("--delays", metavar="0,1", type=delays, help="whole holds; by default both")
    parser.add_argument("--duration", metavar="S", type=seconds, help="longest run [s]; 2 by default")
    parser.add_argument("--rig", metavar="CONFIG", type=Path, help="scene of the K-B plot; configs/arena_rig.yaml")
    parser.add_argument(
        "--walls", metavar="N", type=_COUNT, help="walls a decade in the K-B plot; default 12, 0: no plot"
    )
    parser.add_argument(
        "--workers", metavar="N", type=_WORKERS, help="processes on this machine; by default one a core"
    )
    parser.add_argument(
        "--out", metavar="FOLDER", type=Path, default=Path("arena"),
        help="page, pictures, result and finished cases; the same command continues with those (default: arena)",
    )  # fmt: skip
    parser.add_argument("--force", action="store_true", help="run finished cases again")
    add_allow_code(parser)
    add_json(parser)


def _compare(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `compare`."""
    add_scene(parser)
    parser.add_argument("--algorithms", metavar="A,B,...", type=names, help="algorithms to compare (default: all)")
    parser.add_argument("--duration", metavar="S", type=seconds, help="length of each run [s]; by default the scene's")
    parser.add_argument(
        "--rate", metavar="HZ", type=rate, help="another rate than the scene's, also beyond what a bus could carry"
    )
    parser.add_argument("--can", action="store_true", help="over the whole CAN path instead of without a bus")
    parser.add_argument(
        "--engine", choices=("auto", "numba", "python"), default="python",
        help="engine without a bus; python (default) has the bits of the CAN path, numba differs by rounding; groups "
        "go over CAN with python, and without a bus with numba",
    )  # fmt: skip
    parser.add_argument("--png", metavar="FILE", type=Path, help="picture of the comparison (.png, .svg, .pdf)")
    add_json(parser)


def _design(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `design`."""
    add_scene(parser)
    parser.add_argument(
        "--margin",
        metavar="PART",
        type=float,
        default=MARGIN,
        help="how much larger both could be, as a part; default 0.2",
    )
    parser.add_argument(
        "--tolerance", metavar="PART", type=float, default=TOLERANCE, help="error of the rendered wall; default 0.05"
    )
    parser.add_argument("--engine", choices=("auto", "numba", "python"), default="auto", help="engine of the trials")
    add_json(parser)


def _map(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `map`."""
    parser.add_argument("file", metavar="FILE.h5", type=Path, help="result of canhaptic sweep, finished or not")
    parser.add_argument("--png", metavar="FILE", type=Path, help="picture (.png, .svg, .pdf)")
    parser.add_argument("--html", metavar="FILE", type=Path, help="self-contained page")
    parser.add_argument("--x", metavar="KEY", help="key across; by default the rate, or the first varied key")
    parser.add_argument("--y", metavar="KEY", help="key upwards, or one line per value")
    parser.add_argument("--metric", metavar="NAME", help="one map of this figure, instead of the usual ones")
    parser.add_argument("--axis", metavar="NAME", help="axis of a scene with several; by default the first")
    parser.add_argument(
        "--by", choices=JUDGEMENTS, help="what a wall must be to count; by default stable for unprotected"
    )
    add_allow_code(parser)
    add_json(parser)


def _judged(parser: argparse.ArgumentParser) -> None:
    """Declare the algorithms and the figures by which scenes are judged."""
    parser.add_argument("--controllers", metavar="A,B,...", type=names, default=[], help="judge each scene under these")
    parser.add_argument(
        "--metrics",
        metavar="A,B,...",
        type=names,
        help="fewer are faster; by default all that need no continuous run; a wrong name lists all",
    )


def _sweep(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `sweep`."""
    add_scene(parser)
    parser.add_argument(
        "--vary",
        metavar="KEY=VALUES",
        action="append",
        default=[],
        help="LOW:HIGH:N, LOW:HIGH:log:N or A,B,C of any key of the scene, as in environment.stiffness=1e2:1e6:log:40 "
        "(every axis) or axes.0.torque_limit=5,10; repeatable",
    )
    _judged(parser)
    parser.add_argument(
        "--sample", metavar="lhs:N", type=samples, default=0, help="N points of a Latin hypercube, no grid"
    )
    parser.add_argument("--seed", metavar="N", type=_COUNT, default=0, help="seed of the hypercube")
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--duration", metavar="S", type=seconds, help="length of every run [s]; by default the scene's")
    length.add_argument("--cycles", metavar="N", type=_SOME, help="SYNCs of every scene, at any rate")
    parser.add_argument(
        "--engine", choices=("auto", "numba", "python"), default="auto", help="engine of batched scenes"
    )
    parser.add_argument("--beyond-bus", action="store_true", help="judge rates that the bus could not carry, too")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", metavar="N", type=_WORKERS, help="processes on this machine (1, or one a core)")
    where.add_argument("--dask", metavar="ADDRESS", help="scheduler of a Dask cluster, as in tcp://10.0.0.5:8786")
    parser.add_argument("--chunk", metavar="N", type=_SOME, help="scenes that are finished together")
    parser.add_argument("--out", metavar="FILE.h5", type=Path, help="results; each chunk is there once it is finished")
    again = parser.add_mutually_exclusive_group()
    again.add_argument("--resume", action="store_true", help="go on with FILE.h5 where it was stopped or killed")
    again.add_argument("--force", action="store_true", help="replace FILE.h5")
    add_json(parser)


def _touch(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `touch`."""
    add_scene(parser)
    parser.add_argument("--axis", metavar="NAME", help="which axis or group; by default the first")
    parser.add_argument("--port", type=PORT, default=5007, metavar="N", help="port of the page; 0: any free one")
    parser.add_argument(
        "--pace",
        choices=("even", "real"),
        default="even",
        help="even: cycles that come late are caught up; real: their SYNCs are skipped, as on a rig",
    )
    parser.add_argument("--open", action="store_true", help="open the page in a browser")


def _warm(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `warm`."""
    add_scene(parser)
    _judged(parser)
    add_json(parser)


OPTIONS: Final[dict[str, Callable[[argparse.ArgumentParser], None]]] = {
    "accuracy": _accuracy,
    "arena": _arena,
    "compare": _compare,
    "design": _design,
    "map": _map,
    "sweep": _sweep,
    "touch": _touch,
    "warm": _warm,
}
"""Subcommand -> what declares its arguments."""

"""Arguments of `canhaptic accuracy`."""

import argparse
from pathlib import Path
from typing import Final

from canhaptic.cli.arguments import add_json, add_scene, positive_number, seconds

BUDGET: Final = 12.0
"""Time for timings [s]; as `study.accuracy.study.DEFAULT_BUDGET`, which is imported when the study begins."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `accuracy`."""
    add_scene(parser)
    parser.add_argument(
        "--tolerance",
        metavar="X",
        type=_length,
        help="largest error of the position, as in '1 um' or 1e-6 [m or rad]; by default a tenth of an encoder count",
    )
    parser.add_argument("--axis", metavar="NAME", help="which axis; by default the first")
    parser.add_argument(
        "--duration",
        metavar="S",
        type=seconds,
        help="length of the comparison [s]; by default 1000 sample times at most",
    )
    parser.add_argument(
        "--budget", metavar="S", type=_budget, default=BUDGET, help="time to spend on timing [s]; 0: none"
    )
    parser.add_argument("--png", metavar="FILE", type=Path, help="picture of the study (.png, .svg, .pdf)")
    parser.add_argument("--html", metavar="FILE", type=Path, help="page with hover and zoom")
    parser.add_argument("--markdown", metavar="FILE", type=Path, help="the tables as Markdown")
    add_json(parser)


def _length(text: str) -> float:
    return positive_number(text, ("m", "rad"), "tolerance", 1.0)


def _budget(text: str) -> float:
    return 0.0 if text.strip() == "0" else seconds(text)

"""Arguments of `canhaptic commission`."""

import argparse
from pathlib import Path
from typing import Final

from canhaptic.cli.arguments import add_json, add_scene, seconds

TORQUE: Final = 0.1
TRAVEL: Final = 0.02
SPEED: Final = 0.5
"""As in `commission.laws.CommissioningLimits`, which is imported when commissioning begins."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `commission`."""
    add_scene(parser)
    parser.add_argument(
        "--yes", action="store_true", help="agree to every step; only where all drives are simulated in this process"
    )
    parser.add_argument(
        "--torque", metavar="PART", type=float, default=TORQUE,
        help=f"largest torque, as a part of the rated torque; {TORQUE:g} by default, 0.3 at most",
    )  # fmt: skip
    parser.add_argument(
        "--travel", metavar="X", type=float, default=TRAVEL,
        help=f"distance [m or rad] after which a torque is taken away; {TRAVEL:g} by default",
    )  # fmt: skip
    parser.add_argument(
        "--speed", metavar="V", type=float, default=SPEED,
        help=f"speed [m/s or rad/s] after which a torque is taken away; {SPEED:g} by default",
    )  # fmt: skip
    parser.add_argument("--duration", metavar="S", type=seconds, default=10.0, help="length of the timing test [s]")
    parser.add_argument("--out", metavar="FILE.yaml", type=Path, help="write the values to paste to a file as well")
    add_json(parser)

"""`canhaptic compare CONFIG`: every passivity algorithm on one scene, beside the continuous environment."""

import argparse
from pathlib import Path
from typing import Final

from canhaptic.cli.arguments import add_json, add_scene, check_picture, names, positive_number, scene_of, seconds
from canhaptic.cli.output import note_file, write_json
from canhaptic.cli.progress import run_progress
from canhaptic.study.algorithms import chosen_algorithms
from canhaptic.study.comparison import compare
from canhaptic.study.scenes import cycles_of
from canhaptic.units import Unit
from canhaptic.view.energy_table import make_console

_FASTEST: Final = 1e6  # [Hz]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `compare`."""
    add_scene(parser)
    parser.add_argument("--algorithms", metavar="A,B,...", type=names, help="which; by default every one")
    parser.add_argument("--duration", metavar="S", type=seconds, help="length of each run [s]; by default the scene's")
    parser.add_argument(
        "--rate", metavar="HZ", type=_rate, help="another rate than the scene's, also beyond what a bus could carry"
    )
    parser.add_argument("--can", action="store_true", help="over the whole CAN path instead of without a bus")
    parser.add_argument("--png", metavar="FILE", type=Path, help="picture of the comparison (.png, .svg, .pdf)")
    add_json(parser)


def execute(arguments: argparse.Namespace) -> int:
    """Runs the comparison and prints it; returns 0 whatever the algorithms did.

    Raises:
        InputError: A scene, an algorithm or a picture that cannot be used.
    """
    scene = scene_of(arguments)
    algorithms = chosen_algorithms(arguments.algorithms)
    if arguments.png is not None:
        check_picture(arguments.png)
    total = cycles_of(scene, arguments.duration) * len(algorithms) * len(scene.axes)
    if arguments.rate is not None:
        total = round(total * arguments.rate * scene.bus.sample_time)
    with run_progress(total, scene.bus.sample_time, "free") as progress:
        comparison = compare(
            scene,
            algorithms,
            duration=arguments.duration,
            rate=arguments.rate,
            over_can=arguments.can,
            progress=progress,
        )
    if arguments.json:
        write_json(comparison.result)
    else:
        from canhaptic.study.compare_table import comparison_report

        make_console().print(comparison_report(comparison.result))
    if arguments.png is not None:
        from canhaptic.study.compare_picture import draw_comparison

        draw_comparison(comparison, arguments.png)
        note_file("picture", arguments.png)
    return 0


def _rate(text: str) -> float:
    return positive_number(text, Unit("Hz", "Hz"), "rate", _FASTEST)

"""`canhaptic accuracy CONFIG`: what accuracy costs in time, for the simulated plant and for the loop, with advice."""

import argparse
from pathlib import Path

from canhaptic.cli.arguments import (
    add_json,
    add_scene,
    check_folder,
    check_picture,
    positive_number,
    scene_of,
    seconds,
)
from canhaptic.cli.output import note_file, write_file, write_json
from canhaptic.cli.progress import run_progress
from canhaptic.cli.stop_signal import StopSignal
from canhaptic.study.accuracy.study import DEFAULT_BUDGET, UNITS, AccuracyStudy
from canhaptic.units import Unit
from canhaptic.view.energy_table import make_console


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
        "--budget", metavar="S", type=_budget, default=DEFAULT_BUDGET, help="time to spend on timing [s]; 0: none"
    )
    parser.add_argument("--png", metavar="FILE", type=Path, help="picture of the study (.png, .svg, .pdf)")
    parser.add_argument("--html", metavar="FILE", type=Path, help="page with hover and zoom")
    parser.add_argument("--markdown", metavar="FILE", type=Path, help="the tables as Markdown")
    add_json(parser)


def execute(arguments: argparse.Namespace) -> int:
    """Measures and prints; returns 0, or 130 or 143 after a signal, with what was measured by then.

    Raises:
        InputError: A scene, an axis or a file that cannot be used.
    """
    scene = scene_of(arguments)
    if arguments.png is not None:
        check_picture(arguments.png)
    for path in (arguments.html, arguments.markdown):
        if path is not None:
            check_folder(path)
    with StopSignal() as stop, run_progress(UNITS, scene.bus.sample_time, "free", every=1) as progress:
        study = AccuracyStudy(
            scene,
            arguments.axis,
            tolerance=arguments.tolerance,
            duration=arguments.duration,
            budget=arguments.budget,
            progress=progress,
            stop=stop.requested,
        )
        result = study.run()
    _report(result, arguments)
    return stop.exit_status


def _report(result: dict[str, object], arguments: argparse.Namespace) -> None:
    from canhaptic.study.accuracy.accuracy_table import accuracy_report, markdown

    if arguments.json:
        write_json(result)
    else:
        make_console().print(accuracy_report(result))
    if not result["plant"]:
        return  # stopped before anything could be drawn
    if arguments.png is not None:
        from canhaptic.study.accuracy.accuracy_picture import draw_accuracy

        draw_accuracy(result, arguments.png)
        note_file("picture", arguments.png)
    if arguments.html is not None:
        from canhaptic.study.accuracy.accuracy_page import write_accuracy_page

        write_accuracy_page(result, arguments.html)
        note_file("page", arguments.html)
    if arguments.markdown is not None:
        write_file(arguments.markdown, markdown(result))
        note_file("tables", arguments.markdown)


def _length(text: str) -> float:
    return positive_number(text, Unit("m", "rad"), "tolerance", 1.0)


def _budget(text: str) -> float:
    return 0.0 if text.strip() == "0" else seconds(text)

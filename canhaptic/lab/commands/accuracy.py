"""`canhaptic accuracy CONFIG`: the price of accuracy in time, for the simulated plant and for the loop, with advice."""

import argparse

from canhaptic.cli.long_command import StopSignal
from canhaptic.cli.options import check_page, check_picture, check_place, scene_of
from canhaptic.cli.output import note_file, write_file, write_json, write_note
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy.accuracy_table import accuracy_report, markdown
from canhaptic.lab.studies.accuracy.study import UNITS, study_accuracy
from canhaptic.scene.method import dear_holds
from canhaptic.view.run_lines import make_console
from canhaptic.view.terminal import run_progress


def execute(arguments: argparse.Namespace) -> int:
    """Measure and print; return 0, or 130 or 143 after a signal, with the results obtained so far.

    Raises:
        InputError: A scene, an axis or a file that cannot be used.
    """
    scene = scene_of(arguments, beyond_bus=arguments.beyond_bus)
    if arguments.png is not None:
        check_picture(arguments.png, arguments.force)
    if arguments.html is not None:
        check_page(arguments.html, arguments.force)
    if arguments.markdown is not None:
        check_place(arguments.markdown, arguments.force)
    for text in dear_holds(scene):
        write_note(f"  {text}")
    with StopSignal() as stop, run_progress(UNITS, scene.bus.sample_time, "free", every=1) as progress:
        result = study_accuracy(
            scene,
            arguments.axis,
            tolerance=arguments.tolerance,
            duration=arguments.duration,
            budget=arguments.budget,
            engine=arguments.engine,
            progress=progress,
            stop=stop.requested,
            say=None if arguments.json else lambda row: write_note(f"  {row}"),
        )
    if arguments.json:
        write_json(result)
    else:
        make_console().print(accuracy_report(result, tables=arguments.tables))
    if result["loop"] or result["plant"]:  # else it was stopped before anything could be drawn
        _write(result, arguments)
    return stop.exit_status


def _write(result: Row, arguments: argparse.Namespace) -> None:
    """Write the requested picture, page and tables."""
    from canhaptic.lab.render.accuracy_picture import draw_accuracy, write_accuracy_page

    if arguments.png is not None:
        draw_accuracy(result, arguments.png)
        note_file("picture", arguments.png)
    if arguments.html is not None:
        write_accuracy_page(result, arguments.html)
        note_file("page", arguments.html)
    if arguments.markdown is not None:
        write_file(arguments.markdown, markdown(result))
        note_file("tables", arguments.markdown)

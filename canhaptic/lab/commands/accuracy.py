"""`canhaptic accuracy CONFIG`: error against computing time of the simulated plant and of the loop, with advice."""

import argparse

from canhaptic.cli.options import scene_of
from canhaptic.host.stop_signal import StopSignal
from canhaptic.lab.commands.results import check_files, show, write_files
from canhaptic.lab.studies.accuracy.accuracy_table import accuracy_report, markdown
from canhaptic.lab.studies.accuracy.studied_port import UNITS
from canhaptic.lab.studies.accuracy.study import study_accuracy
from canhaptic.scene.method import dear_holds
from canhaptic.view.terminal import run_progress, write_file, write_note


def execute(arguments: argparse.Namespace) -> int:
    """Measure and print; return 0, or 128 + n after signal n, with the results obtained so far.

    Raises:
        InputError: A scene, an axis or a file cannot be used.
    """
    scene = scene_of(arguments, beyond_bus=arguments.beyond_bus)
    check_files(arguments)
    for text in dear_holds(scene):
        write_note(f"  {text}")
    with StopSignal(insists=True) as stop, run_progress(UNITS, scene.bus.sample_time, "free", every=1) as progress:
        result = study_accuracy(
            scene, arguments.axis, tolerance=arguments.tolerance, duration=arguments.duration,
            budget=arguments.budget, engine=arguments.engine, progress=progress, stop=stop.requested,
            say=None if arguments.json else lambda row: write_note(f"  {row}"),
        )  # fmt: skip
    show(arguments, result, lambda: accuracy_report(result, tables=arguments.tables))
    if result["loop"] or result["plant"]:  # else it was stopped before anything could be drawn
        from canhaptic.lab.render.accuracy_picture import draw_accuracy, write_accuracy_page

        write_files(
            arguments, png=lambda path: draw_accuracy(result, path),
            html=lambda path: write_accuracy_page(result, path),
            markdown=lambda path: write_file(path, markdown(result)),
        )  # fmt: skip
    return stop.exit_status

"""`canhaptic accuracy CONFIG`: the price of accuracy in time, for the simulated plant and for the loop, with advice."""

import argparse

from canhaptic.cli.long_command import StopSignal
from canhaptic.cli.options import check_page, check_picture, check_place, scene_of
from canhaptic.cli.output import note_file, write_file, write_json, write_note
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy.accuracy_table import accuracy_report, markdown
from canhaptic.lab.studies.accuracy.admittance_accuracy import study_display
from canhaptic.lab.studies.accuracy.study import UNITS, AccuracyStudy, length_of
from canhaptic.scene.method import dear_holds
from canhaptic.scene.models import Scene
from canhaptic.view.run_lines import make_console
from canhaptic.view.terminal import run_progress


def execute(arguments: argparse.Namespace) -> int:
    """Measure and print; return 0, or 130 or 143 after a signal, with the results obtained so far.

    Raises:
        InputError: A scene, an axis or a file that cannot be used.
    """
    scene = scene_of(arguments, beyond_bus=arguments.beyond_bus)
    if arguments.png is not None:
        check_picture(arguments.png)
    if arguments.html is not None:
        check_page(arguments.html)
    if arguments.markdown is not None:
        check_place(arguments.markdown)
    with StopSignal() as stop:
        result = (_of_display if _is_of_display(scene, arguments.axis) else _of_axis)(scene, arguments, stop)
    if arguments.json:
        write_json(result)
    else:
        make_console().print(accuracy_report(result, tables=arguments.tables))
    if result["loop"] or result["plant"]:  # else it was stopped before anything could be drawn
        _write(result, arguments)
    return stop.exit_status


def _of_axis(scene: Scene, arguments: argparse.Namespace, stop: StopSignal) -> Row:
    for text in dear_holds(scene):
        write_note(f"  {text}")
    chosen = length_of(scene, arguments.axis, arguments.duration)
    with run_progress(UNITS, scene.bus.sample_time, "free", every=1) as progress:
        return AccuracyStudy(
            chosen.scene,
            arguments.axis,
            tolerance=arguments.tolerance,
            duration=chosen.holds * scene.bus.sample_time,
            budget=arguments.budget,
            engine=arguments.engine,
            progress=progress,
            stop=stop.requested,
            judged=chosen.remark,
            say=None if arguments.json else lambda row: write_note(f"  {row}"),
        ).run()


def _of_display(scene: Scene, arguments: argparse.Namespace, stop: StopSignal) -> Row:
    return study_display(scene, arguments.axis, arguments.duration, stop.requested)


def _is_of_display(scene: Scene, name: str | None) -> bool:
    """Whether an axis or group, the first by default, is an admittance display, or has some."""
    axis = next((of for of in scene.axes if name in (None, of.parameters.name, of.group)), None)
    return axis is not None and axis.parameters.admittance is not None


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

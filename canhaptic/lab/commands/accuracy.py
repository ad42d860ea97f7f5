"""`canhaptic accuracy CONFIG`: the price of accuracy in time, for the simulated plant and for the loop, with advice."""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

from canhaptic.cli.long_command import StopSignal
from canhaptic.cli.options import check_page, check_picture, check_place, scene_of
from canhaptic.cli.output import note_file, write_file, write_json, write_note
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
    if _is_of_display(scene, arguments.axis):
        return _study_display(scene, arguments)
    for text in dear_holds(scene):
        write_note(f"  {text}")
    chosen = length_of(scene, arguments.axis, arguments.duration)
    with StopSignal() as stop, run_progress(UNITS, scene.bus.sample_time, "free", every=1) as progress:
        study = AccuracyStudy(
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
        )
        result = study.run()
    _report(result, arguments)
    return stop.exit_status


def _is_of_display(scene: Scene, name: str | None) -> bool:
    """Whether an axis or group, the first by default, is an admittance display, or has some."""
    axis = next((of for of in scene.axes if name in (None, of.parameters.name, of.group)), None)
    return axis is not None and axis.parameters.admittance is not None


def _study_display(scene: Scene, arguments: argparse.Namespace) -> int:
    from canhaptic.lab.render.accuracy_picture import draw_display_accuracy, write_display_accuracy_page
    from canhaptic.lab.studies.accuracy.admittance_accuracy import (
        display_accuracy_markdown,
        display_accuracy_report,
        study_display,
    )

    with StopSignal() as stop:
        result = study_display(scene, arguments.axis, arguments.duration, stop.requested)
    if arguments.json:
        write_json(result)
    else:
        make_console().print(display_accuracy_report(result))
    if not result["loop"]:
        return stop.exit_status  # stopped before anything could be drawn
    draw, write_page = partial(draw_display_accuracy, result), partial(write_display_accuracy_page, result)
    _write(arguments, draw, write_page, partial(display_accuracy_markdown, result))
    return stop.exit_status


def _report(result: dict[str, object], arguments: argparse.Namespace) -> None:
    from canhaptic.lab.render.accuracy_picture import draw_accuracy, write_accuracy_page
    from canhaptic.lab.studies.accuracy.accuracy_table import accuracy_report, markdown

    if arguments.json:
        write_json(result)
    else:
        make_console().print(accuracy_report(result, tables=arguments.tables))
    if not result["plant"]:
        return  # stopped before anything could be drawn
    draw, write_page = partial(draw_accuracy, result), partial(write_accuracy_page, result)
    _write(arguments, draw, write_page, partial(markdown, result))


def _write(
    arguments: argparse.Namespace,
    draw: Callable[[Path], object],
    write_page: Callable[[Path], object],
    markdown: Callable[[], str],
) -> None:
    """Write the requested picture, page and tables."""
    if arguments.png is not None:
        draw(arguments.png)
        note_file("picture", arguments.png)
    if arguments.html is not None:
        write_page(arguments.html)
        note_file("page", arguments.html)
    if arguments.markdown is not None:
        write_file(arguments.markdown, markdown())
        note_file("tables", arguments.markdown)

"""`canhaptic compare CONFIG`: every passivity algorithm on one scene, compared with the continuous environment."""

import argparse

from canhaptic.cli.options import scene_of
from canhaptic.errors import InputError
from canhaptic.lab.commands.results import check_files, show, write_files
from canhaptic.lab.loop.axis_loop import cycles_of
from canhaptic.lab.render.comparison import comparison_report, draw_comparison, write_comparison_page
from canhaptic.lab.studies.compare import compare, compared_algorithms, has_references
from canhaptic.scene.method import plant_errors
from canhaptic.view.terminal import run_progress, write_note


def execute(arguments: argparse.Namespace) -> int:
    """Run the comparison and print it; return 0 for any result.

    Raises:
        InputError: A scene, an algorithm or a picture cannot be used.
    """
    scene = scene_of(arguments)
    is_drawn = has_references(scene)
    for line in plant_errors(scene):
        write_note(f"  {line}")
    if arguments.png is not None and not is_drawn:
        raise InputError("--png: draws torque axes with their continuous run; draw this one with canhaptic run --png")
    check_files(arguments)
    algorithms = compared_algorithms(scene, arguments.algorithms)
    total = cycles_of(scene, arguments.duration) * len(algorithms)
    if is_drawn:
        total = round(total * len(scene.axes) * (arguments.rate or scene.bus.rate) * scene.bus.sample_time)
    with run_progress(total, scene.bus.sample_time, "free") as progress:
        comparison = compare(
            scene, algorithms, duration=arguments.duration, rate=arguments.rate, over_can=arguments.can,
            engine=arguments.engine, progress=progress,
        )  # fmt: skip
    show(arguments, comparison.result, lambda: comparison_report(comparison.result))
    write_files(
        arguments,
        png=lambda path: draw_comparison(comparison, path),
        html=lambda path: write_comparison_page(comparison, path),
    )
    return 0

"""`canhaptic compare CONFIG`: every passivity algorithm on one scene, compared with the continuous environment."""

import argparse

from canhaptic.cli.options import check_picture, scene_of
from canhaptic.cli.output import note_file, write_json, write_note
from canhaptic.errors import InputError
from canhaptic.lab.loop.axis_loop import cycles_of
from canhaptic.lab.studies.compare import are_displays, compare, compared_algorithms
from canhaptic.scene.method import plant_errors
from canhaptic.scene.models import Scene
from canhaptic.view.run_lines import make_console
from canhaptic.view.terminal import run_progress


def execute(arguments: argparse.Namespace) -> int:
    """Run the comparison and print it; return 0 for any result.

    Raises:
        InputError: A scene, an algorithm or a picture that cannot be used.
    """
    scene = scene_of(arguments)
    for line in plant_errors(scene):
        write_note(f"  {line}")
    if arguments.png is not None:
        _require_picture(scene)
        check_picture(arguments.png, arguments.force)
    algorithms = compared_algorithms(scene, arguments.algorithms)
    total = cycles_of(scene, arguments.duration) * len(algorithms)
    if not scene.groups and not are_displays(scene):
        total = round(total * len(scene.axes) * (arguments.rate or scene.bus.rate) * scene.bus.sample_time)
    with run_progress(total, scene.bus.sample_time, "free") as progress:
        comparison = compare(
            scene, algorithms, duration=arguments.duration, rate=arguments.rate, over_can=arguments.can,
            engine=arguments.engine, progress=progress,
        )  # fmt: skip
    if arguments.json:
        write_json(comparison.result)
    else:
        from canhaptic.lab.render.compare_table import comparison_report

        make_console().print(comparison_report(comparison.result))
    if arguments.png is not None:
        from canhaptic.lab.render.compare_picture import draw_comparison

        draw_comparison(comparison, arguments.png)
        note_file("picture", arguments.png)
    return 0


def _require_picture(scene: Scene) -> None:
    """Refuse a picture of parts without a continuous run.

    Raises:
        InputError: The scene has admittance displays or groups.
    """
    if are_displays(scene):
        raise InputError("--png: for impedance displays; draw an admittance display with canhaptic run --png")
    if scene.groups:
        raise InputError("--png: draws axes with their continuous run; draw a group with canhaptic run --png")

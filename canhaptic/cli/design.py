"""`canhaptic design CONFIG`: the stiffest wall, and its largest damping, that `guarded` renders on a rig."""

import argparse

from canhaptic.cli.arguments import scene_of
from canhaptic.cli.output import write_json
from canhaptic.cli.scene_progress import scene_progress
from canhaptic.scene.display_checks import refuse_displays
from canhaptic.study.design.design_report import design_report, snippet
from canhaptic.study.design.wall import design_wall
from canhaptic.study.sweep.run_sweep import Progress
from canhaptic.view.energy_table import make_console


def execute(arguments: argparse.Namespace) -> int:
    """Searches and prints the wall; returns 0.

    Raises:
        InputError: A scene that cannot be designed for.
        CheckFailedError: No wall at all is rendered.
    """
    scene = scene_of(arguments)
    refuse_displays(scene, "design")
    with scene_progress("trying walls") as show:
        found = design_wall(
            scene, arguments.margin, arguments.tolerance, arguments.engine,
            lambda tried, most: show(Progress(tried, most, 0)),
        )  # fmt: skip
    if arguments.json:
        write_json({**found.result, "yaml": snippet(found.result)})
    else:
        make_console().print(design_report(found.result))
    return 0

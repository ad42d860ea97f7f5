"""`canhaptic design CONFIG`: the stiffest wall that `guarded` renders on a rig, or the lightest mass of a display."""

import argparse

from canhaptic.cli.options import scene_of
from canhaptic.cli.output import write_json, write_note
from canhaptic.lab.commands.scene_progress import scene_progress
from canhaptic.lab.render.design_report import design_report, snippet
from canhaptic.lab.studies.design.wall import design_wall
from canhaptic.lab.studies.runner import Progress
from canhaptic.scene.method import plant_errors
from canhaptic.scene.models import Scene
from canhaptic.view.run_lines import make_console


def execute(arguments: argparse.Namespace) -> int:
    """Search and print the wall; return 0.

    Raises:
        InputError: A scene that cannot be designed for.
        CheckFailedError: No wall at all is rendered.
    """
    scene = scene_of(arguments)
    for line in plant_errors(scene):
        write_note(f"  {line}")
    if all(axis.parameters.admittance is not None for axis in scene.axes):
        return _design_displays(scene, arguments)
    with scene_progress("trying walls") as show:
        found = design_wall(
            scene, arguments.margin, arguments.tolerance, arguments.engine,
            lambda tried, most: show(Progress(tried, most, 0)),
        )  # fmt: skip
    if arguments.json:
        write_json({**found, "yaml": snippet(found)})
    else:
        make_console().print(design_report(found))
    return 0


def _design_displays(scene: Scene, arguments: argparse.Namespace) -> int:
    from canhaptic.lab.studies.design.admittance_design import design_displays, display_design_report, display_snippet

    with scene_progress("trying masses") as show:
        found = design_displays(
            scene, arguments.margin, arguments.tolerance, lambda tried, most: show(Progress(tried, most, 0))
        )
    if arguments.json:
        write_json({**found, "yaml": {name: display_snippet(of) for name, of in found["displays"].items()}})
    else:
        make_console().print(display_design_report(found))
    return 0

"""`canhaptic design CONFIG`: the stiffest wall that `guarded` renders on a rig, or the lightest mass of a display."""

import argparse

from canhaptic.cli.options import scene_of
from canhaptic.lab.commands.results import scene_progress, show
from canhaptic.lab.render.design_report import design_report, snippet
from canhaptic.lab.studies.compare import are_displays
from canhaptic.lab.studies.design.search import design, display_design_report, display_snippet
from canhaptic.lab.studies.runner import Progress
from canhaptic.scene.method import plant_errors
from canhaptic.view.terminal import write_note


def execute(arguments: argparse.Namespace) -> int:
    """Search the stiffest wall, or the lightest mass, and print it; return 0.

    Raises:
        InputError: No wall can be designed for the scene.
        CheckFailedError: Not even the softest wall passes.
    """
    scene = scene_of(arguments)
    for line in plant_errors(scene):
        write_note(f"  {line}")
    displays = are_displays(scene)
    with scene_progress("trying masses" if displays else "trying walls") as progress:
        found = design(
            scene, arguments.margin, arguments.tolerance, arguments.engine,
            lambda tried, most: progress(Progress(tried, most, 0)),
        )  # fmt: skip
    every = {name: display_snippet(of) for name, of in found["displays"].items()} if displays else snippet(found)
    show(arguments, {**found, "yaml": every}, lambda: (display_design_report if displays else design_report)(found))
    return 0

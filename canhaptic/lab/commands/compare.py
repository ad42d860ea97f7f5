"""`canhaptic compare CONFIG`: every passivity algorithm on one scene, compared with the continuous environment."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from canhaptic.cli.options import check_picture, scene_of
from canhaptic.cli.output import note_file, write_json, write_note
from canhaptic.errors import InputError
from canhaptic.lab.loop.axis_loop import chosen_algorithms, cycles_of, own_algorithms
from canhaptic.lab.studies.compare import compare
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
    if all(axis.parameters.admittance is not None for axis in scene.axes):
        return _compare_displays(scene, arguments)
    if scene.groups:
        return _compare_groups(scene, arguments)
    algorithms = chosen_algorithms(arguments.algorithms, own_algorithms(scene))
    if arguments.png is not None:
        check_picture(arguments.png)
    total = cycles_of(scene, arguments.duration) * len(algorithms) * len(scene.axes)
    if arguments.rate is not None:
        total = round(total * arguments.rate * scene.bus.sample_time)
    with run_progress(total, scene.bus.sample_time, "free") as progress:
        comparison = compare(
            scene,
            algorithms,
            duration=arguments.duration,
            rate=arguments.rate,
            over_can=arguments.can,
            engine=arguments.engine,
            progress=progress,
        )
    _print(comparison.result, arguments)
    if arguments.png is not None:
        from canhaptic.lab.render.compare_picture import draw_comparison

        draw_comparison(comparison, arguments.png)
        note_file("picture", arguments.png)
    return 0


def _compare_displays(scene: Scene, arguments: argparse.Namespace) -> int:
    from canhaptic.lab.studies.compare import compare_displays, display_algorithms

    if arguments.rate is not None or arguments.png is not None:
        raise InputError("--rate, --png: for impedance displays; for admittance displays use --set bus.rate=...")
    return _over_can(scene, arguments, display_algorithms, compare_displays)


def _compare_groups(scene: Scene, arguments: argparse.Namespace) -> int:
    from canhaptic.lab.studies.compare import compare_groups, group_algorithms

    if not all(axis.group for axis in scene.axes):
        alone = ", ".join(axis.parameters.name for axis in scene.axes if not axis.group)
        raise InputError(
            f"{scene.source}: has groups and axes that render by themselves ({alone}); make a scene of each"
        )
    if arguments.rate is not None:
        raise InputError("--rate: changes the loop of one axis without a bus; for groups use --set bus.rate=...")
    if arguments.png is not None:
        raise InputError("--png: draws axes with their continuous run; draw a group with canhaptic run --png")
    compared = partial(compare_groups, engine="python" if arguments.can else arguments.engine)
    return _over_can(scene, arguments, group_algorithms, compared)


def _over_can(
    scene: Scene,
    arguments: argparse.Namespace,
    names_of: Callable[[Sequence[str] | None], list[str]],
    compared: Callable[..., Mapping[str, object]],
) -> int:
    total = cycles_of(scene, arguments.duration) * len(names_of(arguments.algorithms))
    with run_progress(total, scene.bus.sample_time, "free") as progress:
        result = compared(scene, arguments.algorithms, duration=arguments.duration, progress=progress)
    _print(result, arguments)
    return 0


def _print(result: Mapping[str, object], arguments: argparse.Namespace) -> None:
    if arguments.json:
        write_json(result)
        return
    from canhaptic.lab.render.compare_table import comparison_report

    make_console().print(comparison_report(result))

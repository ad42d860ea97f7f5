"""`canhaptic design CONFIG`: the stiffest wall that `guarded` renders on a rig, or the lightest mass of a display."""

import argparse
from typing import Final

import yaml
from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.axis_units import damping_unit, effort_unit, si, stiffness_unit
from canhaptic.cli.options import scene_of
from canhaptic.files import scene_title
from canhaptic.lab.commands.results import scene_progress, show
from canhaptic.lab.loop.axis_loop import is_display
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.columns import Column, table_of
from canhaptic.lab.studies.design.search import design, mass_report, mass_snippets
from canhaptic.lab.studies.runner import Progress
from canhaptic.quantities import ACCOUNT
from canhaptic.scene.method import plant_errors
from canhaptic.view.run_lines import rests_on
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
    of_walls = "walls", snippet, design_report
    what, lines, report = ("masses", mass_snippets, mass_report) if is_display(scene) else of_walls
    with scene_progress(f"trying {what}") as progress:
        found = design(
            scene, arguments.margin, arguments.tolerance, arguments.engine,
            lambda tried, most: progress(Progress(tried, most, 0)),
        )  # fmt: skip
    show(arguments, {**found, "yaml": lines(found)}, lambda: report(found))
    return 0


_WALL: Final = "spring_damper_wall"


def snippet(result: Row) -> str:
    """Return wall and algorithm as YAML lines for a scene."""
    stiffness, damping = stiffness_unit(result["unit"]), damping_unit(result["unit"])
    passivity: Row = {"algorithm": "guarded", **result["loop"], **result["hand"]}
    if "network" in result:
        group = {"name": result["group"], "network": result["network"], "passivity": passivity}
        return str(yaml.safe_dump({"groups": [group]}, sort_keys=False))
    wall = {"type": _WALL}
    wall |= {"stiffness": f"{result['stiffness']:g} {stiffness}", "damping": f"{result['damping']:g} {damping}"}
    return str(yaml.safe_dump({"environment": wall, "passivity": passivity}, sort_keys=False))


def design_report(result: Row) -> RenderableType:
    """Return the text of a design for a terminal.

    Args:
        result: Plain values, as `canhaptic design --json` prints them.
    """
    target = f"target: within {100.0 * result['tolerance']:g} %, {100.0 * result['margin']:g} % reserve"
    heading = Text.assemble(
        " ", (scene_title(result["scene"]), "bold"), f"   {result['walls']} walls simulated; {target}"
    )
    stiffness, damping = stiffness_unit(result["unit"]), damping_unit(result["unit"])
    heads = Column(f"stiffness [{stiffness}]", "stiffness", "g"), Column(f"largest damping [{damping}]", "damping", "g")
    trade = table_of("less stiffness permits more damping", heads, result["trade"], result["unit"], 0)
    simulated = " simulated on this rig, with a reserve; `check` gives the limits for any hand within your declarations"
    notes = [Text(simulated), *_replaced(result), Text()]
    return Group(heading, *notes, Text(snippet(result)), *_price(result), trade, *_felt(result))


def _replaced(result: Row) -> list[Text]:
    """Return a note that the wall replaces the scene's own environment, if that is another one."""
    own = result.get("replaces", _WALL)
    if own == _WALL:
        return []
    words = f" the wall replaces environment.type: {own} of the scene; what is printed holds for the wall alone"
    return [Text(words, style="yellow")]


def _price(result: Row) -> list[Text]:
    share, damped = result["stiffness_rendered"], result["damping_rendered"]
    rendered = f"stiffness {100.0 * share:.1f} %" + (f", damping {100.0 * damped:.1f} %" if damped else "")
    lines, unit = [f" rendered, of requested: {rendered}"], stiffness_unit(result["unit"])
    lines += [
        f" largest stiffness certified by {name}: {si(limit, unit, 3)}" for name, limit in result["certified"].items()
    ]
    guarantee = [f" {text}" for text in result.get("guarantee", ()) if text]
    rests, is_none = rests_on(str(result["certificate"])), result["certificate"] == "none"
    lines += guarantee or [f" {rests}" if is_none else f" {ACCOUNT['certificates'].title}: {rests}"]
    rest = si(max(0.0, -result["least_judged"]), "J", 3)
    covered = f" at the motor, {rest} at the handle" if "device_damping" in result["loop"] else ""
    given = si(max(0.0, -result["least_interaction"]), "J", 3)
    lines.append(f" energy given out beyond the energy received: {given}{covered}")
    if result["remark"]:
        lines.append(f" {result['remark']}; for a real rig declare a lower bound")
    texts = [Text(line) for line in lines]
    if result["failing_below"]:
        count = f"{result['failing_below']} of {result['tried_below']}"
        words = f" {count} smaller walls are not rendered within the tolerance; try --margin 0.5"
        texts.append(Text(words, style="yellow"))
    return texts


def _felt(result: Row) -> list[RenderableType]:
    """Return what the hand feels: the wall that holds a given push, the drag, and the slowest contact felt."""
    if "felt" not in result:
        return []
    felt, motion = result["felt"], result["unit"]
    stiffness, effort = stiffness_unit(motion), effort_unit(motion)
    heads = (
        Column(f"push [{effort}]", "push", ".3g"), Column(f"held [{stiffness}]", "held", ".3g"),
        Column(f"certified by hand force [{stiffness}]", "certified", ".3g"),
    )  # fmt: skip
    title = f"stiffest wall rendered within {100.0 * result['tolerance']:g} %, hand at rest in it"
    table = table_of(title, heads, felt["walls"], motion, 0)
    speed, start = f"{felt['speed']:g} {motion}/s", felt["start_speed"]
    contact = "at no speed: a hand goes through it"
    if start is not None:
        contact = f"at approach speeds above {start:.2g} {motion}/s"
    lines = [f" drag before contact, at {speed}: {si(felt['drag'], effort, 2)}", f" this wall is felt {contact}"]
    walls = [wall for wall in felt["walls"] if wall["softer_not_held"]]
    uneven = [f"{wall['softer_not_held']} of {wall['softer']} at {wall['push']:.3g} {effort}" for wall in walls]
    if uneven:
        lines.append(f" softer walls that are not held within the tolerance: {', '.join(uneven)}")
    held = Text(" The wall above assumes a moving hand. For a hand at rest in the wall:")
    return [held, table, *map(Text, lines), *_drags(felt["drags"], motion)]


def _drags(rows: list[Row], motion: str) -> list[RenderableType]:
    """Return the table of drags in free motion, whose energy is available to later contacts."""
    if not rows:
        return []
    title = f"with the energy of drag before a contact, {si(rows[0]['energy'], 'J', 2)}, slower contacts are felt"
    heads = (
        Column(f"drag [{effort_unit(motion)}]", "drag", ".2g"), Column(f"over a distance of [{motion}]", "way", ".2g"),
        Column(f"felt from [{motion}/s]", "start_speed", ".2g"),
    )  # fmt: skip
    return [table_of(title, heads, rows, motion, 0)]

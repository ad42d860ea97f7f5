"""`canhaptic sweep --warm CONFIG`: compile the loops of a scene before the first sweep, as for the image of a CI."""

import argparse
from dataclasses import replace

from canhaptic.cli.options import scene_of
from canhaptic.errors import CheckFailedError
from canhaptic.lab.studies.chunk import ENGINES, run_chunk
from canhaptic.lab.studies.sweep import make_sweep
from canhaptic.lab.studies.vary import listed
from canhaptic.view.run_lines import make_console
from canhaptic.view.terminal import write_json

_SYNCS = 2


def execute(arguments: argparse.Namespace) -> int:
    """Run two SYNCs of the scene under each algorithm, compiled, and print the engine of each; return 0.

    Raises:
        InputError: numba is not installed, or the scene cannot be swept.
        CheckFailedError: A loop cannot be compiled; the error names the reason.
    """
    scene = scene_of(arguments)
    asked = make_sweep(
        scene, [listed("bus.rate", [scene.bus.rate])], controllers=arguments.controllers, cycles=_SYNCS,
        metrics=arguments.metrics, engine="numba",
    )  # fmt: skip
    columns = asked.points.columns(0, len(asked.points))
    result = run_chunk(replace(asked.recipe, is_alone=False), 0, columns)
    names = [str(name) for name in columns.get("controller", ["algorithm of the scene"])]
    found = {
        name: {"engine": ENGINES[engine], "remark": remark}
        for name, engine, remark in zip(names, result.engine.tolist(), result.remark.tolist(), strict=True)
    }
    if arguments.json:
        write_json({"scene": scene.source, "loops": found})
    else:
        for name, of in found.items():
            make_console().print(
                f"  {name}: {'compiled' if of['engine'] == 'numba' else 'not compiled'}  {of['remark']}".rstrip()
            )
    missed = [f"{name}: {of['remark']}" for name, of in found.items() if of["engine"] != "numba"]
    if missed:
        raise CheckFailedError(f"{scene.source}: not compiled: " + "; ".join(missed))
    return 0

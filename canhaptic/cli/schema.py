"""`canhaptic configs --schema`: print the JSON Schema of scene files, for completion and checks in an editor."""

import argparse

from canhaptic.scene.json_schema import scene_schema
from canhaptic.view.terminal import write_json


def execute(arguments: argparse.Namespace) -> int:
    """Print the schema."""
    write_json(scene_schema())
    return 0

"""The same scene by every way of running it: the command line, `canhaptic.simulate`, and `open_rig` for a program."""

import contextlib
import io
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import canhaptic
from canhaptic.cli.main import main
from canhaptic.errors import CanHapticError
from tools.chance import Chance
from tools.truth.judge import Outcome, certificates
from tools.truth.programs import Program
from tools.truth.scenes import TruthScene
from tools.truth.shrink import write_scene

WAYS: Final = ("command line", "simulate", "open_rig")
"""Ways of running a scene, other than the cycle; the last one for programs, in place of the others."""
_SHARE: Final = 0.1


def differences(scene: TruthScene, outcome: Outcome) -> list[str]:
    """Returns a claim for each way of running a scene whose account says something else than that of `judged`.

    What is compared are the words, the certificates, and to the last bit the least true sum of energy.
    """
    if outcome.status != "completed":
        return []
    with tempfile.TemporaryDirectory() as folder:
        path = write_scene(scene, outcome, Path(folder))
        program = next((tag.partition(":")[2] for tag in scene.tags if tag.startswith("program:")), "")
        by = {"open_rig": _by_program(path, scene.seed, program)} if program else _by_commands(path)
    expected = outcome.verdict, outcome.at_handle, outcome.certificates, outcome.least
    return [
        f"{way}: {said}, by the cycle {expected}" for way, account in by.items() if (said := _said(account)) != expected
    ]


def drawn_differences(scene: TruthScene, outcome: Outcome) -> list[str]:
    """Returns the `differences` of some scenes, by the seed."""
    return differences(scene, outcome) if Chance(scene.seed, 59).drawn(_SHARE) else []


def _by_commands(path: Path) -> dict[str, Mapping[str, Any]]:
    said = io.StringIO()
    simulated: Mapping[str, Any]
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
        main(["run", str(path), "--pace", "free", "--json"])
        try:
            simulated = canhaptic.simulate(path, progress=False).account.raw
        except CanHapticError as error:
            simulated = {"passive": type(error).__name__}
    return dict(zip(WAYS, (json.loads(said.getvalue()), simulated), strict=False))


def _by_program(path: Path, seed: int, name: str) -> Mapping[str, Any]:
    """Returns the account of a user's own loop that asks for the torques of a program of `tools.truth.programs`."""
    with canhaptic.open_rig(path, pace="free") as rig:
        program = Program(seed, name, rig.sample_time)
        for turn in rig:
            [(axis, sample)] = turn.items()
            rig[axis].torque = program.torque(sample.sync_index, sample.position)
    return rig.account.raw


def _said(account: Mapping[str, Any]) -> tuple[Any, ...]:
    """Returns what an account says, as `Outcome` has it."""
    ports = {name: port for name, port in account.get("ports", {}).items() if "passive" in port}
    names = tuple(sorted({name for port in ports.values() for name in certificates(port)}))
    least = min((account["truth"][name]["least_interaction"] for name in ports), default=0.0)
    return account.get("passive"), account.get("passive_at_handle", ""), names, least

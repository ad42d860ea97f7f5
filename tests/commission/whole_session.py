"""The demonstration's rig taken through every step, once a process: it takes longer than any other test."""

from functools import cache
from pathlib import Path

import can

from canhaptic.cli.commission import walk
from canhaptic.commission.session import CommissioningLimits, Report, Session, Unattended
from canhaptic.errors import CanHapticError
from canhaptic.scene.load import load_scene

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"


@cache
def whole_session() -> tuple[Report, tuple[list[str], CanHapticError | None], list[can.Message]]:
    """The report, what `walk` returned, and every frame."""
    with can.Bus(interface="virtual", channel="agrees", preserve_timestamps=True) as bus:
        scene = load_scene(DEMO, ["bus.channel=agrees"])
        session = Session(scene, Unattended(lambda _line: None), CommissioningLimits(), lambda: False)
        outcome = walk(session, 0.2)
        return session.report, outcome, list(iter(lambda: bus.recv(0.0), None))

"""Values of a scene that are marked as guesses; no real drive runs on them."""

import re
from typing import TYPE_CHECKING, Final, NamedTuple

from canhaptic.errors import InputError
from canhaptic.scene.models import Scene

if TYPE_CHECKING:
    from canhaptic.host.socketcan_state import Runner

TO_SET: Final = "TO SET"
"""Marks every value that the user has to replace."""
_MARKED: Final = re.compile(rf"^\s*(?:-\s+)?([^#\s].*?)\s#\s*{TO_SET}\b[:,]?\s*(.*)$")


class Guess(NamedTuple):
    """One marked value."""

    line: int  # of the scene file, from 1
    key: str
    value: str  # as written
    note: str  # what the mark says of it; may be empty


def guesses_left(scene: Scene) -> list[Guess]:
    """Return the values of a scene file that are still marked as guesses."""
    found = []
    for number, line in enumerate(scene.text.splitlines(), start=1):
        if marked := _MARKED.match(line):
            key, _, value = marked[1].partition(":")
            found.append(Guess(number, key.strip(), value.strip(), marked[2].strip()))
    return found


def refuses_guesses(scene: Scene, run: "Runner | None" = None) -> bool:
    """Return whether a run of the scene is refused while values are marked: drives may be real.

    Args:
        scene: The scene.
        run: Runs a command and returns what it printed; the kernel is asked with it whether the buses are virtual.
    """
    if scene.simulated:
        return False
    from canhaptic.host.socketcan_state import all_links_are_virtual

    return not all_links_are_virtual(scene, run)


def _is_simulated_elsewhere(scene: Scene) -> bool:
    """Return whether a scene with simulated drives reaches them over UDP, which carries no real CAN bus."""
    return scene.simulation is not None and all(bus.parameters.interface == "udp_multicast" for bus in scene.buses)


def require_no_guesses(scene: Scene) -> None:
    """Return when no value of a scene for real drives is marked as a guess.

    Raises:
        InputError: Some are; names their lines.
    """
    if scene.guessed_timing and refuses_guesses(scene) and not _is_simulated_elsewhere(scene):
        are_displays = all(scene.axis(name).parameters.admittance for name in scene.guessed_timing)
        torque = "" if are_displays else ", torque_window, current_lag, device_friction_bound"
        raise InputError(
            f"{scene.source}: passivity of {', '.join(scene.guessed_timing)}: sync_jitter{torque}: not all are "
            "declared, and the drives are real; measure them (canhaptic commission) and put them there"
        )
    guesses = guesses_left(scene)
    if guesses and refuses_guesses(scene):
        listed = ", ".join(f"{guess.line} ({guess.key})" for guess in guesses)
        raise InputError(
            f"{scene.source}: lines {listed}: marked {TO_SET}, and the drives are real; put the values of your rig "
            "there and take the marks away"
        )

"""Check before a run in which hold each torque acts: reversals of the torque, hands off (`check_hold`)."""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from canhaptic.commission.mass_and_friction import time_the_torque
from canhaptic.commission.session import CommissioningLimits, Session, StepVerdict, Unattended
from canhaptic.commission.torque_tests import largest_torque
from canhaptic.drive.clock import WallClock
from canhaptic.errors import StartError
from canhaptic.scene.models import Scene

_ANNOUNCED: Final = 3.0  # [s] before a real drive moves


def checked_holds(scene: Scene, tell: Callable[[str], None], stop_requested: Callable[[], bool]) -> Scene:
    """Check the hold of each axis with `check_hold: each_start`; return the scene with confirmed `hold_checked`.

    Each drive is started, its torque reversed as in `canhaptic commission`, within a tenth of its rated torque, and
    stopped. Where the hold stays unclear, for instance because a hand was on the handle, the axis runs as declared but
    without `hold_checked`: its account says "hold: not checked".

    Args:
        scene: Scene of a run; each such axis declares `moving_mass`.
        tell: Shows a line to the person at the machine.
        stop_requested: The operator's stop.

    Raises:
        StartError: A torque acts in another hold than declared, or is read back for another.
        RigError: Drive or link failed; torque is zero.
    """
    asked = [axis for axis, of in enumerate(scene.axes) if of.parameters.check_hold is not None]
    if not asked:
        return scene
    session = Session(scene, _Announced(tell, stop_requested, scene), CommissioningLimits(), stop_requested)
    with session.rig_of(with_hand=False):
        for axis in asked:
            if not stop_requested():
                time_the_torque(session, axis, largest_torque(session, axis), scene.axes[axis].loop.moving_mass or 1.0)
    for row in session.report.findings:
        if row.verdict in (StepVerdict.DIFFERS, StepVerdict.FAILED):
            raise StartError(row.axis, f"check_hold: {row.item}", row.found, row.configured, row.text)
    found = {value.axis: value.value for value in session.report.values if value.key == "hold_checked"}
    axes, overrides = list(scene.axes), list(scene.overrides)
    for axis in asked:
        given = axes[axis].parameters
        known = str(found[given.name]) if given.name in found else None
        axes[axis] = replace(axes[axis], parameters=given.model_copy(update={"hold_checked": known}))
        overrides.append(f"axes.{axis}.hold_checked={known or 'null'}")
    return replace(scene, axes=tuple(axes), overrides=tuple(overrides))


class _Announced(Unattended):
    """Dialogue that announces each test, and gives a person at a real drive time to let go or to stop."""

    def __init__(self, tell: Callable[[str], None], stop_requested: Callable[[], bool], scene: Scene) -> None:
        super().__init__(tell)
        self._stop_requested, self._waits = stop_requested, not scene.simulated

    def confirm(self, question: str) -> bool:
        """Announce the test; return whether the operator lets it go on."""
        begin = f" in {_ANNOUNCED:g} s" if self._waits else ", now"
        self.tell(question.replace("Reversals", "check_hold: reversals").replace(", now?", begin))
        clock = WallClock()
        end = clock.now() + round(_ANNOUNCED * 1e9)
        while self._waits and clock.now() < end and not self._stop_requested():
            clock.wait_until(clock.now() + 50_000_000)  # [ns] between two looks at the stop
        return not self._stop_requested()

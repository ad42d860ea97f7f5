"""All exceptions of canhaptic.

    CanHapticError                       exit status
    |- InputError (ValueError)               2   bad input, found before any torque
    |  |- ParameterError                     2   a value outside its physical range
    |  |- SceneError                         2   a scene file; lists every fault at once
    |  |  `- SceneConflictError              2   parts that are valid on their own but do not fit together
    |  |- DictionaryError                    2   an EDS or DCF file
    |  |- BusBudgetError                     2   the frames of one cycle do not fit the bus
    |  `- LogFormatError                     2   an energy log or bus log that cannot be read
    |     `- LogMissingError                 2   there is no file of this name (FileNotFoundError)
    |- LogWriteError (OSError)              2   a log that cannot be written where it was asked for
    |  `- LogStoppedError                   3   a log that ended before its run: a full disk, a file that was deleted
    |- CheckFailedError                      1   a comparison or check the user asked for failed
    |- EventLimitError (RuntimeError)        1   a simulated plant has too many events or matrix products
    |- OwnCodeError (RuntimeError)           1   user code of a scene raised, or returned no finite number
    |- WorkersLostError (RuntimeError)       1   the processes of a sweep died again and again
    `- RigError (RuntimeError)               3   drive or link; the drive is left without torque
       |- StartError                         3   a step of the fail-closed start was not confirmed
       |- StartStoppedError                  3   a signal ended the start
       |- SdoError                           3   an SDO was aborted by the drive or not answered
       |- DriveFaultError                    3   EMCY, fault or unexpected state in the cycle
       |  |- EmergencyError                  3   the drive sent an EMCY
       |  |- DriveStateFaultError            3   the drive is in FAULT
       |  |- StateLeftError                  3   the drive left OPERATION ENABLED
       |  |- NmtStateLeftError               3   the drive left NMT OPERATIONAL
       |  |- NotFollowingError               3   the drive does not follow its target torque
       |  |- TorqueLimitedError              3   the drive limits its torque; no TPDO shows the remaining one
       |  |- ForceRangeError                 3   a force beyond the range of its sensor
       |  |- ForceFrozenError                3   a force sensor that shows the same count for too long
       |  |- TorqueContradictedError         3   a torque read back that was never commanded
       |  `- PositionJumpError               3   a position that no hand can have moved to
       |- LinkError (TimeoutError)           3   lost frames, lost heartbeat, bus-off
       |  |- TpdoLostError                   3   too many SYNCs in a row without an answer
       |  |- HeartbeatLostError              3   a drive fell silent
       |  |- CommandLostError                3   a drive does not act on its RPDO
       |  |- FramesLostError                 3   too many samples or commands were lost
       |  |- TpdoContradictedError           3   different TPDOs with one COB-ID answered one SYNC
       |  |- HoldsContradictedError          3   host and drive count different holds without a new torque
       |  |- SecondMasterError               3   another master sends on the bus
       |  `- BusFailedError                  3   a frame could not be sent, or none be read
       |- SyncsSkippedError                  3   this computer was late for too many SYNCs
       `- ControlError                       3   the controller raised or produced a non-finite torque
          |- EnergyLostError                 3   a port generated more energy than declared
          |- EnergyUncertainError            3   the account no longer knows the energy of a port
          |- OwnCodeLateError                3   user code in a process of its own did not answer
          |- ForceContradictedError          3   encoder and commands prove more energy than the force sensor shows
          |- TorqueNotFiniteError            3   the controller's torque is no number
          `- CycleFailedError                3   anything else was raised in the cycle; it is the cause

A rig that stops by itself raises one of the innermost, by the reason in `canhaptic.drive.safety.link_policy`, with
the last thousand records.

Every message states what happened, the value seen, the limit, and what to do.
"""

import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

_LONGEST: Final = 200  # characters of a foreign error


def escaped(text: str) -> str:
    """Return a text on one line, with control characters written out."""
    return "".join(letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in text)


def cause_of(error: BaseException) -> str:
    """Return the message of an error; for an error raised by user code, one line `TYPE: MESSAGE (FILE:LINE)`.

    LINE is the last line that ran in a file of the folder that holds the user's first file.
    """
    if isinstance(error, CanHapticError):
        return str(error)
    frames = traceback.walk_tb(error.__traceback__)
    foreign = [of for of in frames if not str(of[0].f_globals.get("__name__", "")).startswith("canhaptic.")]
    places = [(Path(frame.f_code.co_filename), line) for frame, line in foreign]
    own = [f" ({path.name}:{line})" for path, line in places if path.parent == places[0][0].parent]
    try:
        message = str(error)
    except Exception:  # user code may raise anything
        message = "an error without a readable message"
    text = escaped(f"{type(error).__name__}: {message}"[:_LONGEST])
    return text + "".join(own[-1:])


class CanHapticError(Exception):
    """Root of every error raised on purpose by canhaptic."""

    exit_status: ClassVar[int] = 1


class InputError(CanHapticError, ValueError):
    """Bad input, found before any torque is sent."""

    exit_status = 2


class ParameterError(InputError):
    """A parameter outside its physical range; names the value and the limit.

    Attributes:
        part: Type of the effect, or key, that was refused; "" where the message concerns a whole section.
    """

    def __init__(self, message: str, part: str = "") -> None:
        self.part = part
        super().__init__(message)


class SceneError(InputError):
    """A scene file that cannot be used; carries every fault found in it.

    Attributes:
        faults: One line per fault, each `file:line:column: path: got X, expected Y`.
    """

    def __init__(self, faults: Sequence[str]) -> None:
        self.faults = tuple(faults)
        super().__init__("\n".join(self.faults))


class OverrideWarning(UserWarning):
    """An override names another type, so that keys of the old type are dropped; the text lists them."""


class SceneConflictError(SceneError):
    """A scene with values that are valid separately but not together, such as a rate that its bus cannot carry."""


class DictionaryError(InputError):
    """An object dictionary (EDS or DCF) that is missing, unreadable or unfit for cyclic torque."""


class BusBudgetError(InputError):
    """The periodic frames do not fit the bus at the requested rate; the message shows the arithmetic."""


class LogFormatError(InputError):
    """A log that is empty, truncated, foreign or of a newer version."""


class LogMissingError(LogFormatError, FileNotFoundError):
    """No file has the name of the log."""


class LogWriteError(CanHapticError, OSError):
    """A log that cannot be written: folder missing or read-only, disk full, writer process lost."""

    exit_status = 2


class LogStoppedError(LogWriteError):
    """A log that could no longer be written during a run: disk full or read-only, file deleted, writer process lost."""

    exit_status = 3


class CheckFailedError(CanHapticError):
    """A failed check or comparison that the user asked for."""


class EventLimitError(CanHapticError, RuntimeError):
    """A simulated plant had too many events, or needed too many matrix products, in one sample time.

    Attributes:
        most: Largest allowed number of events (`accuracy.max_events`).
        state: Modes and states of the plant, as text.
        products: Largest allowed number of matrix products, if that limit was exceeded; 0 if `most` was exceeded.
    """

    def __init__(self, most: int, state: str, where: str = "plant", products: int = 0) -> None:
        self.most, self.state, self.products = most, state, products
        got = f"{most} changes of mode in one sample time, expected at most accuracy.max_events {most}"
        remedy = "give the contact damping, widen a gap, or raise accuracy.max_events"
        if products:
            got = f"{products} products in one sample time, expected at most that many at accuracy.max_events {most}"
            remedy = "the oscillation is too fast: give it damping, more mass or less stiffness, or raise max_events"
        super().__init__(f"{where}: got more than {got}; {remedy}. State: {state}")


class OwnCodeError(CanHapticError, RuntimeError):
    """User code of a scene raised, or returned no number; it is not called again.

    Attributes:
        program: File and class.
        what: What the code did wrong.
    """

    def __init__(self, program: str, what: str, where: str = "") -> None:
        self.program, self.what = program, what
        place = f" {where}" if where else ""
        super().__init__(f"{program}{place}: {what}; correct the program")


class WorkersLostError(CanHapticError, RuntimeError):
    """The processes that compute a sweep died repeatedly, or did not run it; finished chunks are kept."""


class RigError(CanHapticError, RuntimeError):
    """A drive or link failed; torque was set to zero before this was raised.

    Attributes:
        records: The last records before the failure, newest last; empty before the cycle starts.
        axis: Name of the axis whose drive failed; "" if the failure does not concern a single drive.
    """

    exit_status = 3

    def __init__(self, message: str, records: Sequence[Any] = (), axis: str = "") -> None:
        self.records = tuple(records)
        self.axis = axis
        super().__init__(message)


class StartStoppedError(RigError):
    """A signal ended the start before the drives were enabled; they are left disabled."""


class StartError(RigError):
    """A step of the fail-closed start was not confirmed; the drive is left disabled.

    Attributes:
        drive: Name of the axis.
        step: The step that was not confirmed.
    """

    def __init__(self, drive: str, step: str, seen: str, expected: str, remedy: str) -> None:
        self.drive = drive
        self.step = step
        found = f"got {seen}, expected {expected}" if expected else seen
        super().__init__(f"{drive}: {step}: {found}; {remedy}")


class SdoError(RigError):
    """An SDO transfer that the drive aborted or did not answer.

    Attributes:
        index: Index of the object.
        subindex: Subindex of the object.
        code: SDO abort code (CiA 301, table 22); None if the drive sent no valid answer.
    """

    def __init__(self, message: str, index: int, subindex: int, code: int | None = None) -> None:
        self.index = index
        self.subindex = subindex
        self.code = code
        super().__init__(message)


class DriveFaultError(RigError):
    """The drive left OPERATION ENABLED, sent an EMCY or reported a fault during the cycle."""


class LinkError(RigError, TimeoutError):
    """Frames, heartbeats or the bus itself were lost beyond the link policy."""


class ControlError(RigError):
    """The controller raised, or produced a torque that is not finite."""


class EmergencyError(DriveFaultError):
    """A drive sent an EMCY with an error code."""


class DriveStateFaultError(DriveFaultError):
    """The statusword of a drive says FAULT or FAULT REACTION ACTIVE."""


class StateLeftError(DriveFaultError):
    """A drive left OPERATION ENABLED without a fault."""


class NmtStateLeftError(DriveFaultError):
    """A drive left NMT OPERATIONAL: reset, stopped, or commanded by another master."""


class NotFollowingError(DriveFaultError):
    """A drive that followed its target (bit 12 of the statusword) no longer does."""


class TorqueLimitedError(DriveFaultError):
    """A drive limits its torque (bit 11 of the statusword) and no TPDO shows the remaining torque."""


class ForceRangeError(DriveFaultError):
    """The force sensor of an admittance display shows a force beyond its range."""


class ForceFrozenError(DriveFaultError):
    """The force sensor of an admittance display has sent the same count for too long."""


class TorqueContradictedError(DriveFaultError):
    """A torque read back follows from no command, by its size or sign."""


class PositionJumpError(DriveFaultError):
    """A position moved faster than the speed limit of its axis."""


class TpdoLostError(LinkError):
    """Too many consecutive SYNCs without an answer from a drive."""


class HeartbeatLostError(LinkError):
    """A drive's heartbeat stopped."""


class CommandLostError(LinkError):
    """A drive still applies an old torque although newer ones were sent."""


class FramesLostError(LinkError):
    """Too many samples or commands were lost, although never too many in a row."""


class TpdoContradictedError(LinkError):
    """SYNCs were answered by process data with one COB-ID and different content."""


class HoldsContradictedError(LinkError):
    """Host and drive counted different holds in which an old torque acted on."""


class SecondMasterError(LinkError):
    """Another node sent a frame that only this master may send."""


class BusFailedError(LinkError):
    """The interface refused a frame twice, or could not be read."""


class OwnCodeLateError(ControlError):
    """User code in a separate process did not answer for too many holds."""


class SyncsSkippedError(RigError):
    """This computer was late for too many SYNCs."""


class EnergyLostError(ControlError):
    """A port generated more energy than declared."""


class EnergyUncertainError(ControlError):
    """The stated uncertainty of an account grew faster than `energy_uncertainty_limit` allows."""


class ForceContradictedError(ControlError):
    """Encoder and commands of an admittance display prove more energy than its force sensor can have seen."""


class TorqueNotFiniteError(ControlError):
    """The controller requested a torque that is not finite."""


class CycleFailedError(ControlError):
    """An exception in the cycle that canhaptic does not define, such as ZeroDivisionError; `__cause__` holds it."""

"""Keys of an EtherCAT line and of an axis on it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import model_validator

from canhaptic.canopen.esi import EsiDictionary, read_esi
from canhaptic.drive.cycle_parameters import CycleParameters
from canhaptic.drive.profile.torque_axis_parameters import TorqueAxisParameters
from canhaptic.units import PrintablePath, PrintableText, quantity

_MAIL_NS: Final = 10_000_000  # between two looks: into a mailbox for an emergency, or at the clock of a drive
_QUIET_NS: Final = 100_000_000
_FEWEST_WATCHED: Final = 3

ASSIGN_ACTIVATE: Final = 0x0300
"""What switches SYNC0 on in a drive whose file does not say it."""


class EthercatBusParameters(CycleParameters):
    """One EtherCAT line, whose first drive with a distributed clock leads the cycle."""

    type: Literal["ethercat"]
    """Kind of bus."""
    interface: PrintableText = "virtual"
    """`virtual`: drives simulated in this process. Else a network interface of Linux that is for the drives alone, such
    as `eth1` (needs the extra `ethercat`, CAP_NET_RAW and CAP_NET_ADMIN)."""
    frames: Literal[1, 2] = 2
    """Frames in a cycle. 2: read, compute, write, and a torque acts at the next SYNC0. 1: one frame does both, and a
    torque acts one hold later."""
    phase: Annotated[float, quantity("1", ge=0.05, le=0.5)] = 0.25
    """Time after SYNC0 at which the first frame passes the reference clock, as a fraction of the sample time."""
    sync: Literal["dc"] = "dc"
    """What begins a hold: `dc`, SYNC0 of the distributed clock. With others (`sm2`, `free`) it would be unknown."""
    watchdog: Annotated[float, quantity("s", ge=1e-3, le=6.0)] = 0.01
    """Time without a frame after which a drive itself takes its torque away (sync manager watchdog); at least 3 sample
    times, so that no single lost frame ends the run."""
    assign_activate: Annotated[int, quantity("1", ge=0, le=0xFFFF)] | None = None
    """AssignActivate of the drives (0x0980), which starts SYNC0; None: of each ESI, else 0x0300."""

    @model_validator(mode="before")
    @classmethod
    def _has_no_startup(cls, values: Any) -> Any:
        if isinstance(values, Mapping) and "startup" in values:
            text = "startup: a line has none: those of the ESI are sent by themselves, and further writes at the start"
            raise ValueError(f"{text} are drive_objects of the axis")
        return values

    @model_validator(mode="after")
    def _check_watchdog(self) -> Self:
        least = _FEWEST_WATCHED * self.sample_time
        if self.watchdog < least:
            text = f"watchdog is {1e3 * self.watchdog:g} ms, expected at least {1e3 * least:.4g} ms, {_FEWEST_WATCHED}"
            raise ValueError(f"{text} sample times at {self.rate:g} Hz; raise watchdog or rate")
        return self

    @property
    def channel(self) -> None:
        """A line has no channel of its interface."""

    @property
    def rpdo(self) -> Literal["synchronous"]:
        """A torque acts at a SYNC0, never as it arrives."""
        return "synchronous"

    @property
    def delay(self) -> int:
        """Whole holds from the computation of a torque to the hold in which it acts."""
        return 1 if self.frames == 2 else 2

    @property
    def heartbeat_cycles(self) -> int:
        """Sample times between the master's signs of life: every frame is one."""
        return 1

    @property
    def mail_cycles(self) -> int:
        """Sample times between two looks into a mailbox or at a clock."""
        return max(1, round(_MAIL_NS / self.sample_time_ns))

    @property
    def master_silence_ns(self) -> int:
        """Silence [ns] of the master that a drive tolerates."""
        return round(self.watchdog * 1e9)

    @property
    def drive_silence_ns(self) -> int:
        """Longest silence of a drive that the master tolerates [ns]: later than its lost samples end the run."""
        return max(_QUIET_NS, 2 * self.stop_cycles * self.sample_time_ns)


class EthercatAxisParameters(TorqueAxisParameters):
    """One servo drive on an EtherCAT line and the axis behind it. Torques are at the axis: N*m or N."""

    position: Annotated[int, quantity("1", ge=0, le=0xFFFF)]
    """Place of the drive on its line, from 0."""
    esi: PrintablePath
    """Device description (ESI) of the drive."""

    @property
    def dictionary_path(self) -> Path:
        """File of the drive's object dictionary."""
        return self.esi

    def dictionary(self) -> EsiDictionary:
        """Return the drive's object dictionary; raise DictionaryError."""
        return read_esi(self.esi, self.product_code)

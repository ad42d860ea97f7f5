"""Parameters of a CAN bus and of each axis on it in a scene: every value in SI, with its unit and range."""

from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Field, model_validator

from canhaptic.canopen.eds import DriveDictionary, read_dictionary
from canhaptic.canopen.objects import PDO_COUNT, RPDO_COMMUNICATION, TPDO_COMMUNICATION
from canhaptic.drive.cycle_parameters import CycleParameters
from canhaptic.drive.profile.torque_axis_parameters import TorqueAxisParameters
from canhaptic.units import PrintablePath, PrintableText, quantity

LARGEST_U16: Final = 0xFFFF

_NodeId = Annotated[int, quantity("1", ge=1, le=127)]
_PdoNumber = Annotated[int, quantity("1", ge=1, le=PDO_COUNT)]


def _number_of(key: object) -> object:
    """Return the number of a key such as `0x1404`; the validation refuses any other text."""
    try:
        return int(key, 0) if isinstance(key, str) else key
    except ValueError:
        return key


_Index = Annotated[int, BeforeValidator(_number_of)]


class CanBusParameters(CycleParameters):
    """One CAN bus: interface, PDOs and heartbeats."""

    interface: PrintableText = "virtual"
    """python-can interface (`virtual`, `socketcan`, `udp_multicast`, ...)."""
    channel: PrintableText | int | None = None
    """Channel of the interface; None: the default of python-can, for `virtual` a private channel."""
    bitrate: Annotated[int, quantity("bit/s", ge=10_000, le=1_000_000)] = 1_000_000
    """Bit rate of classic CAN; the bus budget is computed from it."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Further keyword arguments of `can.Bus` for this interface."""
    rpdo: Literal["synchronous", "event"] = "synchronous"
    """When a torque acts: at the SYNC after its RPDO (exact energy, one sample late), or when the RPDO arrives."""
    master_id: _NodeId = 126
    """Node ID of the master's heartbeat."""
    heartbeat_period: Annotated[float, quantity("s", ge=1e-3, le=10.0)] = 0.02
    """Period of the heartbeats of drives and master; the master sends at the nearest SYNC."""
    heartbeat_timeout: Annotated[float, quantity("s", ge=5e-3, le=30.0)] = 0.1
    """Heartbeat silence after which drive or master counts the other as lost; never less than three periods."""
    tpdo_timeout: Annotated[float, quantity("1", gt=0.0, le=0.95)] = 0.5
    """Fraction of the sample time within which the TPDOs must arrive after SYNC; later ones count as late."""
    compute_latency: Annotated[float, quantity("s", ge=0.0, le=0.1)] = 20e-6
    """Time between the last TPDO and the first RPDO that the bus budget reserves for the host."""
    emcy_reserve: Annotated[int, quantity("count", ge=0, le=128)] = 1
    """EMCY frames in one cycle that the bus budget reserves."""

    @property
    def delay(self) -> int:
        """Whole holds from the computation of a torque to the hold in which it acts."""
        return 1 if self.rpdo == "synchronous" else 0

    @property
    def heartbeat_cycles(self) -> int:
        """Sample times between heartbeats of the master."""
        return max(1, round(self.heartbeat_period * 1e9 / self.sample_time_ns))

    @property
    def master_silence_ns(self) -> int:
        """Silence [ns] of the master that a drive tolerates: whole milliseconds, three heartbeats at least."""
        longest = max(round(self.heartbeat_timeout * 1e9), 3 * self.heartbeat_cycles * self.sample_time_ns)
        return -(-longest // 1_000_000) * 1_000_000

    @property
    def heartbeat_ms(self) -> int:
        """Value of 0x1017 of the drives [ms]: `heartbeat_period` as closely as the object allows."""
        return max(1, min(LARGEST_U16, round(self.heartbeat_period * 1e3)))

    @property
    def consumer_heartbeat(self) -> int:
        """Value of 0x1016:01 of the drives: the master's node ID and the silence [ms] that they tolerate."""
        return self.master_id << 16 | self.master_silence_ns // 1_000_000

    @property
    def guard_time_ms(self) -> int:
        """Value of 0x100C of a drive that times guard requests [ms], which the master sends with its heartbeats."""
        silence = self.master_silence_ns // 1_000_000
        return max(-(-self.heartbeat_cycles * self.sample_time_ns // 1_000_000), -(-silence // 0xFF))

    @property
    def life_time_factor(self) -> int:
        """Value of 0x100D of such a drive: guard times without a request that it tolerates."""
        return -(-(self.master_silence_ns // 1_000_000) // self.guard_time_ms)

    @property
    def drive_silence_ns(self) -> int:
        """Longest silence of a drive that the master tolerates [ns]: three heartbeats at least."""
        return max(round(self.heartbeat_timeout * 1e9), 3 * round(self.heartbeat_period * 1e9))


class AxisParameters(TorqueAxisParameters):
    """One servo drive and the axis behind it. Torques are at the axis: N*m (rotary) or N (linear)."""

    node_id: _NodeId
    """CANopen node ID of the drive; unique on its bus."""
    eds: PrintablePath
    """Object dictionary (EDS or DCF) of the drive."""
    rpdo_number: _PdoNumber | None = None
    """RPDO to use instead of the one chosen from the dictionary."""
    tpdo_numbers: Annotated[tuple[_PdoNumber, ...], Field(min_length=1, max_length=4)] | None = None
    """TPDOs to use instead of those chosen from the dictionary."""
    pdo_cob_ids: dict[_Index, int] = Field(default_factory=dict)
    """COB-ID by index of the communication object (0x1404: 0x205); for PDOs beyond the fourth."""

    @model_validator(mode="after")
    def _check_cob_ids(self) -> "AxisParameters":
        for index, cob_id in self.pdo_cob_ids.items():
            if not any(0 <= index - first < PDO_COUNT for first in (RPDO_COMMUNICATION, TPDO_COMMUNICATION)):
                text = f"{index:#06x} is no PDO communication object; use 0x1400..0x15FF or 0x1800..0x19FF"
                raise ValueError(f"pdo_cob_ids: {text}")
            if not 0x101 <= cob_id <= 0x57F:  # free of NMT, SYNC, EMCY, SDO and heartbeat
                raise ValueError(f"pdo_cob_ids: {index:#06x}: got {cob_id:#x}, expected a free COB-ID 0x101..0x57F")
        return self

    @property
    def dictionary_path(self) -> Path:
        """File of the drive's object dictionary."""
        return self.eds

    def dictionary(self) -> DriveDictionary:
        """Return the drive's object dictionary for its node ID; raise DictionaryError."""
        return read_dictionary(self.eds, self.node_id)

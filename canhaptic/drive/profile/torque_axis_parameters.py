"""Parameters of one axis, for any fieldbus: every value in SI, with unit and range."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, field_validator

from canhaptic.drive.profile.causality import IMPEDANCE, Impedance
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.errors import ParameterError
from canhaptic.units import Name, OnDemand, Parameters, PrintableText, quantity

if TYPE_CHECKING:
    from canhaptic.canopen.attached_devices import Brake
    from canhaptic.drive.profile.motion_parameters import MotionParameters
else:  # an impedance display without a brake loads nothing of them
    Brake = Any
    MotionParameters = Any

ReadBack = Literal["demand", "actual", "none"]
"""Torque in the process data of a drive: 0x6074, 0x6077, or none."""


def _by_place(objects: object) -> object:
    """Return `drive_objects` with keys of one form, `0x607D.1`; raise ValueError for an unknown object."""
    if not objects or not isinstance(objects, dict):
        return objects or {}
    from canhaptic.drive.profile.drive_objects import place_of

    return {"0x{:04X}.{}".format(*place_of(key)): value for key, value in objects.items()}


def _settings(text: str | None) -> str | None:
    """Return a text of settings; raise ValueError where it is none."""
    if text:
        from canhaptic.drive.profile.drive_objects import settings_of

        settings_of(text)
    return text


_Settings = Annotated[PrintableText | None, AfterValidator(_settings)]


class TorqueAxisParameters(Parameters):
    """Properties of an axis that the profile needs. Torques are at the axis: N*m (rotary) or N (linear)."""

    name: Name
    """Name of the axis in messages, tables and logs; no other axis has it."""
    quirks: tuple[str, ...] = ()
    """Named deviations of this drive from the standard (`canhaptic.drive.profile.quirks`)."""
    unit: Literal["m", "rad"] = "rad"
    """Position unit: m (linear) or rad (rotary). The units of all other keys of the axis follow from it."""
    counts_per_unit: Annotated[float, quantity("count/m", "count/rad", gt=0.0)]
    """Position counts (0x6064) per metre or radian of the axis."""
    direction: Literal[1, -1] = 1
    """-1 turns the sign of position and torque together."""
    rated_torque: Annotated[float, quantity("N", "N*m", gt=0.0, le=1e6)] | None = None
    """Torque of the axis at 1000 per mille: that of the motor times the gear; needed when the drive does not state
    0x6076."""
    transmission: Annotated[float, quantity("1/m", "1", ge=1e-6, le=1e6)] = 1.0
    """Torque or force of the axis per torque of the motor (gear ratio, 1/pulley radius); scales 0x6076."""
    torque_limit: Annotated[float, quantity("N", "N*m", gt=0.0)]
    """Largest torque that is sent, however much is requested; also written to 0x6072 where the drive has it."""
    limit_by_master: bool = False
    """Whether the master alone keeps a `torque_limit` below the least value of 0x6072 that the dictionary states, which
    the drive is then given; false: refused. `canhaptic evidence` sets it for its run at a tenth."""
    torque_verified: Literal["weight", "balance", "mass", "no"] | None = None
    """How the scale of the torque was verified: by a weight on an arm, a spring balance, or the known mass
    (`canhaptic commission`). Needed on real drives; with `no` they are sent a hundredth of `torque_limit` at most."""
    position_reference: Literal["absolute", "index_home", "at_start", "sensor"] | None = None
    """Origin of the counts: an absolute encoder, the index that `canhaptic commission --home` or the vendor's tool
    homed to, the place where power came on, or a sensor of the rig. Needed on real drives; with `at_start` a run shows
    where its walls lie."""
    torque_rate_limit: Annotated[float, quantity("N/s", "N*m/s", gt=0.0)] | None = None
    """Largest rise of the torque per second, on either side of zero; a fall to zero is never slowed."""
    power_limit: Annotated[float, quantity("W", gt=0.0)] | None = None
    """Largest power that the torque may put into the user's side."""
    speed_limit: Annotated[float, quantity("m/s", "rad/s", gt=0.0)] | None = None
    """Largest speed of the position between two SYNCs; beyond it the rig stops. By default 10 m/s or 100 rad/s, faster
    than a hand."""
    energy_loss_limit: Annotated[float, quantity("J", gt=0.0, le=10.0)] | Literal["none"] | None = None
    """Energy that the port may generate beyond the declared amount before the rig stops; a group takes the least of its
    axes. By default 10 mJ; in simulation only for algorithms that promise passivity. `none` in simulation only."""
    energy_uncertainty_limit: Annotated[float, quantity("W", gt=0.0, le=1e3)] | Literal["none"] | None = None
    """Growth [J/s] of what the algorithm leaves uncertain of the port's energy, and doubtful samples, that is tolerated
    for ever; beyond it, and what 1 s of it makes, the rig stops. By default 0.1 W where there is a limit on the energy
    loss, and only of what grows while frames are lost, since timing alone may leave more uncertain: that lets every
    shipped scene pass with 1 % of frames lost, and ends most in contact with 10 %. A display has none by default."""
    read_back: Literal["auto", "demand", "actual", "none"] = "auto"
    """Torque in the TPDO: 0x6074, 0x6077, nothing; auto takes the first that the dictionary allows."""
    torque_tolerance: Annotated[float, quantity("1", gt=0.0, le=1.0)] = 0.05
    """Largest difference of a measured torque (0x6077) from its command, as a part of the rated torque."""
    demand_reported: Literal["before", "after"] = "before"
    """Whether the TPDO of a SYNC carries the torque held before that SYNC or the one that begins with it."""
    hold_checked: PrintableText | None = None
    """Drive, firmware, process data and rate with which `canhaptic commission` found a torque to act in the declared
    hold. None, or with another drive: the account says that its holds were not checked, and a real drive gets no
    positive certificate."""
    settings_checked: _Settings = None
    """Scale, sign and limits that the drive had when `canhaptic commission` measured it: `0x6075=5000 0x607E=0`. The
    start refuses a drive in which one differs. None: not compared."""
    settings_accepted: _Settings = None
    """Values of such settings that were changed since on purpose, in the same form."""
    check_hold: Literal["each_start"] | None = None
    """`each_start` tests before each run in which hold a torque acts: hands off, it moves the handle for some seconds
    by at most 20 mm or mrad, and refuses a drive that acts in another hold. None: only `canhaptic commission` tests."""
    hold_dither: Annotated[float, quantity("N", "N*m", gt=0.0)] | None = None
    """Amplitude of a random sign sequence in the torques of `guarded`: a run then shows in which hold they act, and
    has no certificate where it is another one than declared. At least half a step of the torque. None: not added."""
    admittance: (
        Annotated[MotionParameters, OnDemand("canhaptic.drive.profile.motion_parameters:MotionParameters")] | None
    ) = None
    """Parameters of an admittance display, force in and velocity out. None: an impedance display."""
    vendor_id: Annotated[int, quantity("1", ge=0, le=0xFFFFFFFF)] | None = None
    """Expected 0x1018:01; any when absent."""
    product_code: Annotated[int, quantity("1", ge=0, le=0xFFFFFFFF)] | None = None
    """Expected 0x1018:02; any when absent."""
    watchdog: bool | Literal["heartbeat", "life_guarding", "rpdo_timer"] = True
    """Means by which the drive itself notices a dead master: it waits for a heartbeat (0x1016), for guard requests
    (0x100C, 0x100D), or for RPDOs (event timer, 0x1400:05); 0x6007 is its reaction. true: the first that the dictionary
    has. false: none, and a killed master leaves the torque on."""
    reset_fault: bool = False
    """Whether the start may reset a fault of the drive; the cycle never does."""
    brake: Annotated[Brake, OnDemand("canhaptic.canopen.attached_devices:Brake")] | None = None
    """Holding brake of the axis; None: it has none."""
    drive_objects: Annotated[dict[str, int], BeforeValidator(_by_place)] = Field(default_factory=dict)
    """Values of the drive's own limits, ramps and reactions, in its units, written by the start: `{0x6065: 2000}`.
    0x6065, 0x6066, 0x605A, 0x605E, 0x607D.1, 0x607D.2, 0x607F, 0x6080, 0x6083 to 0x6085, 0x60C5, 0x60C6."""
    restore_limits: bool = False
    """Whether the stop restores 0x6072, 0x607F and 0x6080 too, like everything else that the start wrote."""
    sdo_timeout: Annotated[float, quantity("s", ge=1e-3, le=10.0)] = 0.3
    """Time allowed for the answer to an SDO request before it is repeated."""
    start_timeout: Annotated[float, quantity("s", ge=0.0, le=60.0)] = 5.0
    """Time allowed for the first answer, for example after power-on."""
    step_timeout: Annotated[float, quantity("s", ge=1e-2, le=60.0)] = 1.0
    """Time allowed for the drive to confirm one step of the start."""

    @property
    def dictionary_path(self) -> Path:
        """File of the drive's object dictionary."""
        raise NotImplementedError

    def dictionary(self) -> Any:
        """Return the drive's object dictionary; raise DictionaryError."""
        raise NotImplementedError

    @property
    def largest_speed(self) -> float:
        """`speed_limit`, or its default [m/s or rad/s]."""
        return self.speed_limit or {"m": 10.0, "rad": 100.0}[self.unit]

    @field_validator("quirks")
    @classmethod
    def _check_quirks(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        try:
            quirks_of(names)
        except ParameterError as error:
            raise ValueError(str(error).removeprefix("quirks: ")) from error
        return names

    @property
    def written_objects(self) -> dict[tuple[int, int], int]:
        """The values of `drive_objects` by (index, subindex)."""
        return {(int(key[2:6], 16), int(key[7:])): value for key, value in self.drive_objects.items()}

    @property
    def causality(self) -> "Impedance | MotionParameters":
        """What the drive is sent and what it shows."""
        return self.admittance or IMPEDANCE

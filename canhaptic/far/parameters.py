"""Keys of the section `far` of a scene: an axis that is coupled to a rig behind a network, or to a slow program."""

from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from canhaptic.units import Name, Parameters, PrintablePath, PrintableText, quantity

LOOPBACK: Final = "loopback"
"""`peer` of a rig that runs in the same process (`canhaptic run --with`)."""

WORLD: Final = ("127.0.0.1", 5577), ("127.0.0.1", 5578)
"""Addresses of a rig and of its program, `world: loopback`."""

SWINGS: Final = 5.0
"""Largest stiffness times round trip, over the damping, of a spring that does not swing."""


class Coupling(Parameters):
    """What this rig renders of the other side."""

    type: Literal["spring", "model"] = "spring"
    """`spring`: a spring and a damper to the position of the other rig, which follows this one by a spring of its own.
    `model`: the wall that the other rig has found, kept until it gets beyond it, and nothing in free space; with
    `world` the wall or spring that the program asks for."""
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e6)]
    """Stiffness of the spring, or of the wall; with `world` the most that the program may ask for."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e4)] = 0.0
    """Damping of the spring, of the speed between both sides, or of the wall; with `world` the most of it."""


class FromFar(Parameters):
    """The most that a far side is believed, right or wrong: the rig gives the hand no more of it than this."""

    energy: Annotated[float, quantity("J", gt=0.0, le=1e3)]
    """Largest energy received and not sent back."""
    power: Annotated[float, quantity("W", gt=0.0, le=1e4)]
    """Largest rate at which it comes."""


class FarParameters(Parameters):
    """An axis coupled to a far side: a local model and a total of energy arrive, never a torque."""

    name: Name
    """Name of the link."""
    axis: Name
    """Name of the axis; it has no environment."""
    peer: PrintableText | None = None
    """Address of the other rig, `10.0.0.7:5577`; `loopback`: the scene after `--with`, in the same process."""
    world: PrintableText | None = None
    """In place of `peer`: address of a program that uses `canhaptic.World`; `loopback`: 127.0.0.1:5578, and this rig
    listens at 127.0.0.1:5577."""
    listen: PrintableText | None = None
    """Address of this rig, at which the other one reaches it, `10.0.0.3:5577`."""
    key: PrintablePath | None = None
    """File of the key that both rigs share, made by `canhaptic new --far-key FILE`; only the loopback needs none."""
    coupling: Coupling
    """What this rig renders of the other side."""
    level: Annotated[float, quantity("J", gt=0.0, le=10.0)] = 0.06
    """Energy that the hand puts in before the link closes, and that each side keeps: a reserve, not a cost."""
    drag: Annotated[float, quantity("N*s/m", "N*m*s/rad", gt=0.0, le=1e3)] = 4.0
    """Damping by which a side earns what is lacking."""
    silence: Annotated[float, quantity("s", ge=1e-3, le=10.0)] = 0.1
    """Time without a new authentic packet after which the link has ended."""
    then: Literal["hold", "damp", "release"] = "release"
    """What is rendered then: a spring to where the axis is, a damper, or the torque falls to 0 in 0.2 s."""
    from_far: FromFar = Field(default_factory=lambda: FromFar(energy=2.0, power=20.0))
    """Limits of what is believed of the other side; a real rig declares its own."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.peer is None) is (self.world is None):
            raise ValueError("peer: expected either peer, the address of another rig, or world, that of a program")
        if self.world is not None and self.coupling.type != "model":
            raise ValueError("coupling: got type spring, expected type: model, as the program says what is rendered")
        if self.other != LOOPBACK:
            key = "peer" if self.world is None else "world"
            is_near = address(self.other, key)[0] in ("127.0.0.1", "localhost")
            if self.listen is None:
                raise ValueError("listen: missing, expected the address at which the other side reaches this rig")
            address(self.listen, "listen")
            if self.key is None and not is_near:
                text = f"missing, but {key} is not on this computer; make one by `canhaptic new --far-key link.key`"
                raise ValueError(f"key: {text} and copy it to both")
        return self

    @property
    def other(self) -> str:
        """Address of the other side as written."""
        return self.peer or self.world or ""

    @property
    def places(self) -> tuple[tuple[str, int], tuple[str, int]]:
        """Own address, and that of the other side."""
        if self.world == LOOPBACK:
            return WORLD
        return address(self.listen or "", "listen"), address(self.other, "peer")

    @property
    def declares_limits(self) -> bool:
        """Whether `from_far` was given."""
        return "from_far" in self.model_fields_set


def address(text: str, key: str) -> tuple[str, int]:
    """Return host and port of an address such as `10.0.0.7:5577`.

    Raises:
        ValueError: It is none.
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 1 << 16:
        raise ValueError(f"{key}: got {text!r}, expected HOST:PORT, such as 10.0.0.7:5577, or {LOOPBACK}")
    return host, int(port)


def faults_of(
    far: FarParameters, reserve: float, *, is_real: bool, round_trip: float, unit: str
) -> list[tuple[str, str]]:
    """Return what of a section `far` a rig cannot render, each with its key.

    Args:
        far: The section.
        reserve: Energy that the torques under way may give out [J].
        is_real: Whether the drives may be real.
        round_trip: Simulated time to the other side and back [s].
        unit: Unit of the stiffness.
    """
    found, most = [], far.coupling.damping * SWINGS
    if is_real and not far.declares_limits:
        text = "missing, expected the most energy and power that the far side is believed"
        found.append(("from_far", f"{text}, such as {{energy: 2 J, power: 20 W}}"))
    if far.level < reserve:
        text = f"got {far.level:.3g} J, expected at least the reserve of {reserve:.2g} J"
        found.append(("level", f"{text}: so much may the torques under way give out before they can change"))
    if far.coupling.type == "spring" and far.coupling.stiffness * round_trip > most:
        text = f"got {far.coupling.stiffness:.3g} {unit} at a round trip of {1e3 * round_trip:.3g} ms, which"
        found.append(
            (
                "coupling",
                f"{text} swings; expected at most {SWINGS:g} times the damping over the round trip, or type: model",
            )
        )
    if round_trip >= far.silence:
        text = f"got {1e3 * far.silence:.3g} ms, expected more than the round trip of {1e3 * round_trip:.3g} ms"
        found.append(("silence", f"{text}: the first answer would come after the link has ended"))
    return found

"""Passivity algorithms of one axis, each in its own file: the table of their names, and what they have in common.

`Controller` is their interface, stepped once per SYNC; `LoopProperties` are the properties of the loop around them.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Final, Protocol, Self

from pydantic import model_validator

from canhaptic.control.balance import EnergyBalance
from canhaptic.control.certificates.scalar_bounds import HoldTiming, hold_timing
from canhaptic.control.environments import Environment, plain
from canhaptic.registry import load, load_algorithm
from canhaptic.units import Parameters, quantity

_HERE: Final = "canhaptic.control.passivity"
_RIVALS: Final = "canhaptic.lab.rivals"

LITERATURE: Final[dict[str, str]] = {
    "adaptive_reference": f"{_RIVALS}.adaptive_reference:AdaptiveReference",
    "windowed_observer": f"{_RIVALS}.windowed_observer:WindowedObserver",
    "bounded_observer": f"{_RIVALS}.bounded_observer:BoundedObserver",
    "force_gradient": f"{_RIVALS}.force_gradient:ForceGradient",
    "force_augmentation": f"{_RIVALS}.force_augmentation:ForceAugmentation",
    "energy_tank": f"{_RIVALS}.energy_tank:EnergyTank",
    "ultimate_passivity": f"{_RIVALS}.ultimate_passivity:UltimatePassivity",
}
"""Algorithms of other authors, for comparison, listed as in `ALGORITHMS`; none has a proven bound on its torque."""

ALGORITHMS: Final[dict[str, str]] = {
    "unprotected": f"{_HERE}.unprotected:Unprotected",
    "a_priori_dissipation": f"{_RIVALS}.a_priori_dissipation:APrioriDissipation",
    "internal_dissipation": f"{_HERE}.internal_dissipation:InternalDissipation",
    "passivity_observer": f"{_HERE}.passivity_observer:PassivityObserver",
    "energy_bounding": f"{_RIVALS}.energy_bounding:EnergyBounding",
    "guarded": f"{_HERE}.guarded:Guarded",
    **LITERATURE,
}
"""Name in a scene -> "module:Class". Every class has `parameters_type` and takes (environment, parameters, loop)."""

_DITHERED: Final = {"guarded": f"{_HERE}.hold_dither:DitheredGuarded"}
"""The same for algorithms that can test in which hold their torques act."""


RANGES: Final = ("torque_window", "current_lag")
"""Keys of the loop that may be given as `[least, largest]`."""


class LoopProperties(Parameters):
    """Properties of the loop around a controller; an optional value that is not known is None."""

    sample_time: Annotated[float, quantity("s", ge=1e-6, le=1.0)]
    """Time T from SYNC to SYNC."""
    delay: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Whole holds from the computation of a torque to the hold in which it acts: 0 for event-driven RPDOs, 1 for
    synchronous ones."""
    moving_mass: Annotated[float, quantity("kg", "kg*m^2", gt=0.0)] | None = None
    """Lower bound of the inertia rigid with the encoder."""
    device_damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] | None = None
    """Certain viscous damping of the device, a lower bound."""
    device_damping_bound: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] | None = None
    """Upper bound of the device damping (b_max of the hand-force certificate). None: not known."""
    device_friction: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)] | None = None
    """Certain dry friction of the device while it moves, a lower bound. None: not known, taken as 0."""
    device_friction_bound: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)] | None = None
    """Upper bound of the dry friction and cogging of the device, which may push the handle out of a contact as well as
    hold it. None: not known, taken as 0 by a controller."""
    device_cogging_bound: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)] | None = None
    """Part of `device_friction_bound` that can pull: cogging, weight, wind-up of a gear. The rest only brakes, if
    `presliding_stiffness` is declared too. None: all of it can pull, as always in a group."""
    presliding_stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0)] | None = None
    """Stiffness of dry friction before it slides, as an energy: F^2 / 2E, with F the friction that only brakes, static
    peak included, and E the most that it gives back at a reversal. The first slope of a force over a small motion is
    larger and no lower bound. It improves the bound above 1.31 times the moving mass over T^2. None: not known."""
    sync_jitter: Annotated[float, quantity("1", ge=0.0, le=0.5)] | None = None
    """Largest relative deviation of a hold from T: from position to position it lasts T (1 +- jitter).
    None: not known, taken as 0 by a controller."""
    torque_window: Annotated[float, quantity("s", ge=0.0, le=1.0)] | None = None
    """Latest time after a SYNC at which its torque acts (event RPDO, wire time), or `[earliest, latest]`. None: not
    known, taken as 0."""
    current_lag: Annotated[float, quantity("s", ge=0.0, le=1.0)] | None = None
    """Largest time constant of the motor's torque, or `[least, largest]`. None: not known, taken as 0."""
    torque_window_least: Annotated[float, quantity("s", ge=0.0, le=1.0)] | None = None
    """The first number of `torque_window`."""
    current_lag_least: Annotated[float, quantity("s", ge=0.0, le=1.0)] | None = None
    """The first number of `current_lag`."""
    encoder_count: Annotated[float, quantity("m", "rad", ge=0.0)] = 0.0
    """Displacement of one encoder count; 0 for an ideal encoder."""
    torque_quantum: Annotated[float, quantity("N", "N*m", ge=0.0)] = 0.0
    """Smallest step of the torque command; 0 for an ideal actuator."""
    torque_limit: Annotated[float, quantity("N", "N*m", gt=0.0)] | None = None
    """Largest torque the drive applies."""
    torque_rate_limit: Annotated[float, quantity("N/s", "N*m/s", gt=0.0)] | None = None
    """Largest rate of rise of the torque that the limiter permits."""
    power_limit: Annotated[float, quantity("W", gt=0.0)] | None = None
    """Largest power into the user's side that the limiter permits."""

    @model_validator(mode="before")
    @classmethod
    def _with_two_ends(cls, section: Any) -> Any:
        """Take `[least, largest]` of a time apart."""
        ranges = [key for key in RANGES if isinstance(section, Mapping) and isinstance(section.get(key), list | tuple)]
        section = dict(section) if ranges else section
        for key in ranges:
            if len(section[key]) != 2:
                raise ValueError(f"{key}: got {len(section[key])} numbers, expected [least, largest], or the largest")
            section[f"{key}_least"], section[key] = section[key]
        return section

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        for key in RANGES:
            least, largest = getattr(self, f"{key}_least"), getattr(self, key)
            if least is not None and (largest is None or least > largest):
                raise ValueError(f"{key}: got [{least:g}, {largest}] s, expected [least, largest]; exchange them")
        return self

    @property
    def brakes(self) -> bool:
        """Whether a lower bound of the device's damping or dry friction is declared."""
        return self.device_damping is not None or self.device_friction is not None

    @property
    def timing(self) -> HoldTiming:
        """Bounds of a hold's length and of the time until a new torque acts, from the declared properties.

        Raises:
            ParameterError: The torque window is as long as a hold.
        """
        least = self.torque_window_least or 0.0, self.current_lag_least or 0.0
        return hold_timing(
            self.sample_time, self.sync_jitter or 0.0, self.torque_window or 0.0, self.current_lag or 0.0, least
        )


class Controller(Protocol):
    """A passivity algorithm of one axis, with the environment that it renders."""

    def reset(self) -> None:
        """Clear the state: zero stored energy, no queued torque, no last position."""

    def sample_lost(self) -> EnergyBalance:
        """Return the balance of a SYNC whose position was lost: the last command is repeated, and nothing is booked.

        The next `step` then books one displacement for several holds. If their torques differed, the energy is
        uncertain by the difference times the excursion, and its lowest value is booked.
        """

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Book the energy of the hold that just ended, and return its balance with the torque to send next.

        The first call after `reset` only stores the position: its balance is all zero.

        Args:
            position: Axis position at this SYNC [m or rad].
            torque_applied: Torque the drive held during the hold that ended here [N or N*m].

        Raises:
            ControlError: The position or torque is not finite.
        """


def build_controller(
    environment: Environment, algorithm_name: str, parameters: Parameters | None, loop: LoopProperties,
    hold_dither: float | None = None,
) -> Controller:  # fmt: skip
    """Return a controller of one axis, at rest and without stored energy.

    Args:
        environment: Environment to render.
        algorithm_name: A name of `ALGORITHMS`.
        parameters: The algorithm's own `parameters_type`; None for its defaults.
        loop: Sample time, delay and other properties of the loop.
        hold_dither: Amplitude of the random torques that `guarded` adds to test in which hold its torques act
                [N or N*m]; None: no test.

    Raises:
        ParameterError: Unknown name, parameters of another algorithm, or a missing value that the algorithm needs.
    """
    algorithm, chosen = load_algorithm(ALGORITHMS, algorithm_name, "passivity algorithm", parameters)
    controller: Controller
    if hold_dither is not None and algorithm_name in _DITHERED:  # the scene refuses others
        dithered = load(_DITHERED, algorithm_name, "passivity algorithm")
        controller = dithered(plain(environment), chosen, loop, hold_dither)
    else:
        controller = algorithm(plain(environment), chosen, loop)
    return controller

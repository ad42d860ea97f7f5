"""Sums behind the figures of one run, gathered SYNC by SYNC in constant memory.

They are kernels, so that interpreted runs, compiled runs and recorded rows give the same sums. `figures` defines how a
figure is computed from them.
"""

from dataclasses import dataclass
from math import inf
from typing import Annotated, Final

from canhaptic.control.balance import RANKS, Branch, EnergyBalance, along
from canhaptic.control.environments import Environment
from canhaptic.kernels import OFTEN_ZERO, new

_FREE, _START, _EXACT, _STICKY, _FALLBACK, _DEPLETED, _EXIT, _HELD = (branch.value for branch in list(Branch)[:8])


BRIEF: Final = frozenset((
    "cycles", "diverged", "true_position", "lost", "least_covered", "interaction", "least_interaction", "margin",
    "believed", "dissipated", "believed_margin", "believed_error", "surplus", "torque_peak",
))  # fmt: skip
"""Sums that do not need the environment."""


@dataclass(frozen=True, slots=True)
class MeterSettings:
    """Constants of a run that its sums depend on."""

    last_from: float = 0.0  # SYNC at which the last part of the run begins (`figures.last_rows`)
    damping_per_time: float = 0.0  # b / T of the device [N/m or N*m/rad]
    friction: float = 0.0  # Coulomb friction of the device in motion [N or N*m]
    is_brief: bool = False  # whether only the sums of `BRIEF` are gathered
    torque_limit: float = inf  # largest torque of the drive [N or N*m]
    damping: float = 0.0  # damper of the environment [N*s/m or N*m*s/rad]
    by_place: Annotated[bool, OFTEN_ZERO] = False  # whether it is a sum, whose damping depends on the place


@dataclass(slots=True)
class Meter:
    """Running sums and extremes of one axis; energies in [J]. `Figure.sums` refers to the fields by name."""

    cycles: float = 0.0
    diverged: float = 0.0
    true_position: float = 0.0
    highest: float = -inf
    lowest: float = inf
    lost: float = 0.0
    least_covered: float = 0.0
    interaction: float = 0.0
    least_interaction: float = 0.0
    margin: float = 0.0
    believed: float = 0.0
    dissipated: float = 0.0
    believed_margin: float = 0.0
    believed_error: float = 0.0
    surplus: float = 0.0
    torque: float = 0.0
    torque_peak: float = 0.0
    variation: float = 0.0
    certificate: float = 0.0  # the largest of `RANKS`
    contacts: float = 0.0
    damping: float = 0.0
    damping_least: float = inf
    damping_most: float = 0.0
    state: float = 0.0
    force: float = 0.0
    rendered: float = 0.0
    asked: float = 0.0
    sizes_asked: float = 0.0
    sizes_sent: float = 0.0
    damping_requested: float = 0.0
    free: float = 0.0
    start: float = 0.0
    exact: float = 0.0
    sticky: float = 0.0
    fallback: float = 0.0
    depleted: float = 0.0
    exit: float = 0.0
    position_squares: float = 0.0
    position_worst: float = 0.0
    force_squares: float = 0.0
    force_worst: float = 0.0
    last: float = 0.0
    last_highest: float = -inf
    last_lowest: float = inf
    last_force: float = 0.0
    last_state: float = 0.0
    last_asked: float = 0.0


def take(
    environment: Environment,
    settings: MeterSettings,
    meter: Meter,
    cycle: int,
    position: float,
    true_position: float,
    torque: float,
    interaction: float,
    balance: EnergyBalance,
) -> None:
    """Add one SYNC to the sums.

    Args:
        environment: The rendered environment.
        settings: Constants of the sums.
        meter: Sums of the run; changed.
        cycle: Index of the SYNC.
        position: Position that the controller received [m or rad].
        true_position: True position [m or rad].
        torque: Torque applied in the hold that ended [N or N*m].
        interaction: True energy received since the start [J].
        balance: Balance booked by the controller.
    """
    lose(settings, meter, true_position - meter.true_position if cycle else 0.0)
    take_hold(environment, settings, meter, cycle, position, true_position, torque, abs(torque), interaction, balance)


def lose(settings: MeterSettings, meter: Meter, moved: float) -> None:
    """Add what the device of a motor lost in a hold in which it moved [m or rad]."""
    meter.lost += settings.damping_per_time * (moved * moved) + settings.friction * abs(moved)


def take_hold(
    environment: Environment, settings: MeterSettings, meter: Meter, cycle: int, position: float, true_position: float,
    torque: float, largest: float, interaction: float, balance: EnergyBalance,
) -> None:  # fmt: skip
    """Add one SYNC to all sums but the losses; see `take`.

    Args:
        environment: The rendered environment.
        settings: Constants of the sums.
        meter: Sums of the run; changed.
        cycle: Index of the SYNC.
        position: Position that the controller received, of the first motor [m or rad].
        true_position: True position of the first motor [m or rad].
        torque: Torque applied in the hold that ended; of several motors, the Euclidean norm [N or N*m].
        largest: Largest size of the torque of any motor [N or N*m].
        interaction: True energy received since the start [J].
        balance: Balance booked by the controller.
    """
    meter.cycles, meter.true_position = cycle + 1.0, true_position
    take_energy(meter, interaction, balance)
    meter.torque_peak = max(meter.torque_peak, largest)
    if settings.is_brief:
        return
    meter.highest, meter.lowest = max(meter.highest, true_position), min(meter.lowest, true_position)
    meter.variation += abs(torque - meter.torque)
    meter.torque = torque
    branch = balance.branch
    if branch != _FREE and branch != _EXIT and branch != _HELD:  # noqa: PLR1714 - `in` would search
        rendered = balance.damping_rendered
        meter.contacts += 1.0
        meter.damping += rendered
        meter.damping_least = min(meter.damping_least, rendered)
        meter.damping_most = max(meter.damping_most, rendered)
        take_contact(environment, settings, meter, position, torque, balance)
    meter.certificate = max(meter.certificate, float(RANKS[balance.certificate]))
    count_branch(meter, branch)
    if meter.cycles > settings.last_from:
        take_last_part(environment, meter, true_position, torque)


def miss(
    environment: Environment, settings: MeterSettings, meter: Meter, cycle: int, true_position: float, torque: float,
    interaction: float,
) -> None:  # fmt: skip
    """Add a SYNC whose position did not reach the controller; see `take`."""
    nothing, surplus = 0.0, meter.surplus
    balance = new(EnergyBalance, (
        nothing, nothing, nothing, nothing, nothing, nothing, surplus, nothing, nothing, nothing, nothing, _HELD,
        nothing, 0, nothing, nothing,
    ))  # fmt: skip
    take(environment, settings, meter, cycle, 0.0, true_position, torque, interaction, balance)


def take_energy(meter: Meter, interaction: float, balance: EnergyBalance) -> None:
    """Add the energies of one SYNC; see `take`."""
    meter.interaction = interaction
    meter.least_interaction = min(meter.least_interaction, interaction)
    meter.least_covered = min(meter.least_covered, interaction + meter.lost)
    meter.believed += balance.h_i
    meter.dissipated += balance.h_r
    believed, dissipated = meter.believed, meter.dissipated
    meter.margin = min(meter.margin, interaction - dissipated)
    meter.believed_margin = min(meter.believed_margin, believed - dissipated)
    meter.believed_error = max(meter.believed_error, abs(believed - interaction))
    meter.surplus = balance.h_dis


def diverge(meter: Meter) -> None:
    """Record that a run diverged."""
    meter.diverged = 1.0


def compare(meter: Meter, position: float, torque: float, continuous_position: float, continuous_torque: float) -> None:
    """Add the difference of one SYNC from the continuous environment.

    Args:
        meter: Sums of the run; changed.
        position: True position [m or rad].
        torque: Torque applied in the hold that ended [N or N*m].
        continuous_position: Position in the continuous environment [m or rad].
        continuous_torque: Mean continuous torque over the hold that ended [N or N*m].
    """
    error = position - continuous_position
    meter.position_squares += error * error
    meter.position_worst = max(meter.position_worst, abs(error))
    error = torque - continuous_torque
    meter.force_squares += error * error
    meter.force_worst = max(meter.force_worst, abs(error))


def count_branch(meter: Meter, branch: int) -> None:
    """Add one hold to the counter of its branch, the case in which the algorithm computed the torque."""
    if branch == _FREE:
        meter.free += 1.0
    elif branch == _EXACT:
        meter.exact += 1.0
    elif branch == _STICKY:
        meter.sticky += 1.0
    elif branch == _START:
        meter.start += 1.0
    elif branch == _FALLBACK:
        meter.fallback += 1.0
    elif branch == _DEPLETED:
        meter.depleted += 1.0
    elif branch == _EXIT:
        meter.exit += 1.0


def take_last_part(environment: Environment, meter: Meter, true_position: float, torque: float) -> None:
    """Add a SYNC of the last part of the run."""
    meter.last += 1.0
    meter.last_highest = max(meter.last_highest, true_position)
    meter.last_lowest = min(meter.last_lowest, true_position)
    if not environment.relaxes:
        meter.last_force -= torque
        if environment.contact(true_position):
            state = environment.true_state(true_position, 0.0, 0.0)
            meter.last_state += state
            meter.last_asked += environment.effort(state)


def take_contact(
    environment: Environment, settings: MeterSettings, meter: Meter, position: float, torque: float,
    balance: EnergyBalance,
) -> None:  # fmt: skip
    """Add a hold in contact to the sums of what was asked for and rendered."""
    meter.damping_requested += settings.damping
    if settings.by_place:
        asked = environment.damping_at(environment.true_state(position, 0.0, 0.0))
        meter.damping_requested += asked - settings.damping
    if not environment.relaxes:
        state = environment.true_state(position, 0.0, 0.0)
        meter.force -= torque
        meter.state += state
        asked = environment.effort(state)
        meter.rendered += along(asked, torque)
        meter.asked += abs(asked)
        meter.sizes_asked += min(abs(asked), settings.torque_limit)
        meter.sizes_sent += min(abs(balance.torque), settings.torque_limit)

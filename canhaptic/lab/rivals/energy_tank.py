"""`energy_tank`: stiffness beyond a constant value draws its energy from a tank, whose energy limits it.

The force is K_c x + b x (K - K_c) + d v with 0 <= b <= 1. T is the energy in the tank: it grows by what the damper
dissipates, while T is below `most_energy`, and by what the variable spring takes up, and falls by what that spring
gives back. b is the largest value that leaves T above `least_energy` if the next hold moves like the last,

    -b (K - K_c) x D <= T - least_energy + (energy of the damper in a hold like the last),   D the motion in it

Constraint and tank are those of `VariableImpedanceWithEnergyTank::on_tank_update` in
`variable_impedance_energy_tank.cpp` of the package qp_ros2, which was read. It follows F. Ferraguti, C. Secchi and C.
Fantuzzi, ICRA 2013, doi:10.1109/ICRA.2013.6631284, which was not read. "Passive hierarchical impedance control via
energy tanks" by Dietrich et al., read as a transcript, has the same limits of a tank.

Departures: one axis, so that the quadratic program is the quotient above; the tank's energy is counted from the torque
applied, exact for each hold, whereas the sources integrate; the tank begins empty instead of with 2 J; the power out of
the tank has no limit. The motion of a hold is not known beforehand, so that it promises nothing.
"""

from dataclasses import dataclass
from typing import Annotated

from canhaptic.control.damping import DamperVelocity
from canhaptic.control.passivity.stepped import Hold, SteppedController
from canhaptic.control.passivity.unprotected import Asked, Reply, SampledRun, SampledState, sampled_kernel
from canhaptic.kernels import Buffer, new
from canhaptic.units import quantity


class EnergyTankParameters(DamperVelocity):
    """Parameters of the constant spring and of the tank."""

    constant_stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e9)] = 0.0
    """Constant stiffness K_c, rendered even if the tank is empty."""
    initial_energy: Annotated[float, quantity("J", ge=0.0, le=1e3)] = 0.0
    """Initial energy of the tank, which the display may generate."""
    least_energy: Annotated[float, quantity("J", ge=0.0, le=1e3)] = 0.0
    """Energy of the tank below which nothing is taken out."""
    most_energy: Annotated[float, quantity("J", gt=0.0, le=1e3)] = 3.0
    """Energy in the tank from which on the damper's dissipation is not added; the default is that of the source."""


@dataclass(slots=True)
class _EnergyTankState(SampledState):
    """State kept from SYNC to SYNC; a ring buffer holds the share of the variable spring in each command, 0..1."""

    brought: float = 0.0  # energy in the tank beyond the initial one [J]


def respond(run: SampledRun[EnergyTankParameters, _EnergyTankState], hold: Hold, asked: Asked) -> Reply:
    """Send the force of the constant stiffness, and as much of the spring's remaining force as the tank supplies."""
    given, state, parts, spring = run.settings.given, run.state, run.memory.own, asked.spring
    place = state.axis.oldest
    fill(given, state, hold, part_applied(parts, place, hold.missed))
    variable = spring - constant_force(given.constant_stiffness, state.model.true, spring)
    share = allowed_share(given, state, hold, variable, asked.damper)
    rendered = spring - (1.0 - share) * variable
    torque = rendered + asked.damper
    parts[place] = share * variable / torque if torque != 0.0 else 0.0
    return new(Reply, ((rendered / spring if spring != 0.0 else 1.0), rendered, asked.damper, 0.0, asked.damping))


def part_applied(parts: Buffer, place: int, missed: int) -> float:
    """Return the variable spring's fraction of the force that acted in the hold that ended, 0..1.

    After lost samples it is unknown which command acted, so that the whole spring counts; the drive repeated the newest
    command, which replaces those whose holds ended.
    """
    if missed == 0:
        return parts[place]
    first = (place - missed) % len(parts)
    for behind in range(min(missed, len(parts))):
        parts[first + behind - len(parts)] = parts[first - 1]
    return 1.0


def constant_force(stiffness: float, depth: float, spring: float) -> float:
    """Return the force of the spring of constant stiffness, limited to the environment's force [N or N*m]."""
    force = stiffness * depth
    return force if abs(force) < abs(spring) else spring


def fill(given: EnergyTankParameters, state: _EnergyTankState, hold: Hold, part: float) -> None:
    """Add to the tank what damper and variable spring absorbed in a hold; `part` of its force came from that spring."""
    state.brought += part * hold.h_i
    dissipated = hold.damper * hold.displacement
    if dissipated > 0.0 and given.initial_energy + state.brought < given.most_energy:
        state.brought += dissipated


def allowed_share(
    given: EnergyTankParameters, state: _EnergyTankState, hold: Hold, variable: float, damper: float
) -> float:
    """Return b, the fraction of the variable spring's force that the tank's energy permits in the next hold, 0..1.

    Args:
        given: Parameters of the run.
        state: State of the axis.
        hold: The hold that ended; the next is assumed to move like it.
        variable: Force of the variable spring at b = 1 [N or N*m].
        damper: Force of the damper [N or N*m].
    """
    taken = -variable * hold.displacement
    if taken <= 0.0:
        return 1.0
    there = given.initial_energy + state.brought - given.least_energy + max(0.0, damper * hold.displacement)
    return min(1.0, max(0.0, there / taken))


class EnergyTank(SteppedController):
    """Controller that renders the environment with a spring force limited by the energy in a tank."""

    parameters_type = EnergyTankParameters
    kernel = sampled_kernel(respond, _EnergyTankState, kept=lambda settings: settings.hold.delay + 1)

"""`a_priori_dissipation`: the algorithm of ref. [12], which fixes the dissipation of a hold in advance (eqs. 5-7).

The energy to be dissipated in a hold is T d v^2 with the velocity computed before it; the rest of the stored
and received energy gives the next state. Early in a contact this a-priori energy can exceed what the user has put in:
the stored energy then falls instead of rising, down to zero. The paper does not say what follows, although this decides
whether the failure of Fig. 5 appears. Measured on the wall of Figs. 4-5 (100 N/m, 5 Ns/m; user of 60 N/m, 5 Ns/m,
0.25 kg, 0.1 m at 0.5 Hz), the variation of the force divided by that of the continuous wall is:

    after the store emptied in contact                              40 Hz    100 Hz
    eq. 14 as printed, v = x / T, when the user pushes inward         0.9       68
    eq. 14 as printed, at the next sample after any motion            1.4       73
    eq. 14 with the velocity from the displacement                    0.9      1.6
    not until the contact ends (the user falls through)               0.9      0.6 (33 mm rms)

So the failure at 100 Hz is that of the printed start, used deep inside the wall: the whole penetration counts as the
displacement of one sample, the a-priori dissipation of that velocity empties the store at once, and this repeats. The
default is the first line (`rearm: printed`); `rearm: displacement` is the third, far better than the paper's Fig. 5.

Departures from print: the state of eq. 7 is taken on the side of the contact; a drive switched on inside the contact
takes its velocity from the displacement, never from the penetration; the velocity of eq. 6 is the one inside the torque
applied in that very hold; holds are booked to the end as in `internal_dissipation`.
"""

from dataclasses import dataclass
from typing import Literal

from canhaptic.control.environments import Environment
from canhaptic.control.passivity.internal_dissipation import (
    Storage,
    StoredModelParameters,
    StoredModelSettings,
    StoredModelState,
    approximate,
    damping_of,
    dissipation,
    empty,
    entered_by,
    is_deadlocked,
    pushed_inward,
    start,
    step,
    stored_model_settings,
)
from canhaptic.control.passivity.stepped import Hold, HoldAccount, SteppedController, hold_memory
from canhaptic.kernels import Kernel
from canhaptic.kernels.records import filled


class APrioriDissipationParameters(StoredModelParameters):
    """Parameters that ref. [12] does not fix."""

    rearm: Literal["printed", "displacement"] = "printed"
    """Velocity at a restart in contact without stored energy: `printed`: x / T (eq. 14), or from the displacement."""

    @property
    def rearms_as_printed(self) -> bool:
        """Whether `rearm` is `printed`: settings of compiled loops hold numbers, not texts."""
        return self.rearm == "printed"


@dataclass(slots=True)
class _APrioriDissipationState(StoredModelState):
    """State kept from SYNC to SYNC."""

    met: bool = False  # whether a contact began since the first position


def touch(
    environment: Environment,
    settings: StoredModelSettings,
    state: _APrioriDissipationState,
    hold: Hold,
    entered: bool,
) -> HoldAccount:
    """Book a hold that ended in contact: start the stored state if the contact is new or nothing is stored."""
    storage, displacement = state.storage, hold.displacement
    state.met = state.met or entered
    if entered or (is_deadlocked(storage) and pushed_inward(environment, storage, displacement)):
        printed = settings.given.rearms_as_printed and state.met and not entered
        state.met = True
        change = storage.true if printed else entered_by(environment, storage, displacement)
        return start(environment, storage, change, hold.elapsed, hold.h_i - hold.h_pas)
    return exchange(environment, settings, storage, hold)


def exchange(environment: Environment, settings: StoredModelSettings, storage: Storage, hold: Hold) -> HoldAccount:
    """Book the dissipation at the velocity that the hold's torque contains, and store what is left (eqs. 6, 7)."""
    lost = dissipation(damping_of(environment, settings, storage), hold)
    account = approximate(environment, storage, hold.elapsed, lost, hold.h_i - hold.h_pas)
    if storage.h_s == 0.0:
        empty(storage)
    return account


class APrioriDissipation(SteppedController):
    """Controller of one axis with the paper's predecessor algorithm, whose dissipation is fixed in advance."""

    parameters_type = APrioriDissipationParameters
    kernel = Kernel(
        stored_model_settings, _APrioriDissipationState, hold_memory, filled(step, touch=touch, exchange=exchange)
    )

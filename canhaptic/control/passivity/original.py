"""`original`: the algorithm of ref. [12], dissipation fixed a priori (eqs. 5-7), on the same ledger.

The energy to be dissipated in a hold is T d v^2 with the velocity that was computed before it; what remains of stored
and received energy gives the next state. Early in a contact that a-priori energy can exceed what the user has put in:
the store falls instead of rising, and empties. What happens then the text does not print, and on it depends whether
the failure of Fig. 5 shows. Measured on the wall of Figs. 4-5 (100 N/m, 5 Ns/m; user of 60 N/m, 5 Ns/m, 0.25 kg, 0.1 m
at 0.5 Hz), force variation over that of the continuous wall's:

    after the store emptied in contact                              40 Hz    100 Hz
    eq. 14 as printed, v = x / T, when the user pushes inward         0.9       68
    eq. 14 as printed, at the next sample whatever the motion         1.4       73
    eq. 14 with the velocity from the displacement                    0.9      1.6
    not until the contact ends (the user falls through)               0.9      0.6 (33 mm rms)

So the failure at 100 Hz is that of the printed start used deep inside the wall: the whole penetration counts as the
displacement of one sample, the a-priori dissipation of that velocity empties the store at once, and so on. The default
is the first line (`rearm: printed`); `rearm: displacement` is the third, and far better than the paper's Fig. 5.

Departures from print: the state of eq. 7 is taken on the side of the contact; a drive switched on inside the contact
takes its velocity from the displacement, never from the penetration; the velocity of eq. 6 is the one inside the torque
applied in that very hold; holds are booked to the end as in `internal_dissipation`.
"""

from typing import ClassVar, Literal

from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import Hold
from canhaptic.control.passivity.storage import UNTOUCHED, Account
from canhaptic.control.passivity.stored_model import StoredModel, StoredModelParameters
from canhaptic.units import Parameters


class OriginalParameters(StoredModelParameters):
    """What ref. [12] leaves to choose."""

    rearm: Literal["printed", "displacement"] = "printed"
    """Velocity of the start after the store emptied in contact: x / T as printed (eq. 14), or from the displacement."""


class Original:
    """The predecessor of the paper's algorithm for one axis."""

    parameters_type: ClassVar[type[Parameters]] = OriginalParameters

    def __init__(self, environment: Environment, parameters: OriginalParameters, loop: LoopProperties) -> None:
        self._model = StoredModel(environment, parameters, loop)
        self._storage = self._model.storage
        self._rearm_as_printed = parameters.rearm == "printed"
        self.reset()

    def reset(self) -> None:
        """Forgets everything: nothing stored, no torque in flight, no last position."""
        self._model.reset()
        self._met = False

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Books the hold that ended; see `Controller.step`."""
        opened = self._model.open(position, torque_applied)
        if opened is None:
            self._met = False
            return AT_REST
        hold, changed = opened
        storage = self._storage
        if storage.zone:
            account = self._touch(hold, changed)
        elif changed or hold.h_i != 0.0:
            account = storage.leave(self._update(hold))
        else:
            account = UNTOUCHED
        return self._model.close(hold, account)

    def hold(self) -> EnergyBalance:
        """Repeats the last command for want of a position; see `Controller.hold`."""
        return self._model.repeat()

    def _touch(self, hold: Hold, entered: bool) -> Account:
        """Books a hold that ended in contact."""
        storage = self._storage
        self._met = self._met or entered
        if entered or (storage.deadlocked and storage.pushed_inward(hold.displacement)):
            printed = self._rearm_as_printed and self._met and not entered
            self._met = True
            change = storage.true if printed else storage.entered_by(hold.displacement)
            return storage.start(change, hold.h_i - hold.h_pas)
        return self._update(hold)

    def _update(self, hold: Hold) -> Account:
        """Dissipates what the velocity inside the torque of this hold demands (eqs. 6, 7)."""
        account = self._storage.approximate(self._model.dissipation(hold), hold.h_i - hold.h_pas)
        if self._storage.h_s == 0.0:
            self._storage.empty()
        return account

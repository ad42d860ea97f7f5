"""The state of a network as it was paid for: every change of it balances the energy of a hold."""

from collections.abc import Sequence
from typing import Final

from canhaptic.control.balance import Branch
from canhaptic.control.multi_axis.energy_along_scale import EnergyAlongScale
from canhaptic.control.multi_axis.requested_efforts import GroupMotion
from canhaptic.control.passivity.hold_account import HoldAccount
from canhaptic.control.port_hamiltonian.discrete_gradient import extension, gradient

_ROUNDING: Final = 1e-12  # of the energy at hand: below it a rest is rounding, not a leak


class ScaledState:
    """State, stored energy and the rules of the paper's flow chart (Fig. 6).

    Attributes:
        h_s: Energy stored at the state, computed from it [J].
        engaged: Whether anything can be felt.
        pace: Size of the last change of state over the step of the model: of its velocity over the measured one.
    """

    def __init__(self, motion: GroupMotion, delay: int) -> None:
        """Follows the network of a motion.

        Args:
            motion: Of the group.
            delay: Whole holds between computation and action.
        """
        self._motion, self._network, self._delay = motion, motion.network, delay
        self.reset()

    def reset(self) -> None:
        """Nothing stored, no velocity."""
        self.h_s, self.engaged, self.pace = 0.0, False, 0.0
        self._blind, self._touched = 0, False

    def begin(self) -> None:
        """Takes the first coordinates: what is strained there stores energy nobody put in, and is let go."""
        self.reset()
        if self._motion.coordinates is not None:
            self._network.begin(self._motion.coordinates)
            self._release()

    def _release(self) -> None:
        network = self._network
        for i, rest in enumerate(self._to_rest()):
            network.state[i] += rest
        network.settle()
        self.h_s = network.energy
        self._touched = self._touches()

    def exchange(self, h_m: float, damped: float, power: float) -> HoldAccount:
        """Books a hold whose motion `GroupMotion.move` has taken.

        Args:
            h_m: Energy that the model received [J].
            damped: Damper efforts inside the torques applied, times the displacements [J].
            power: The same efforts times the velocities they came from, times the hold (eq. 18) [J].
        """
        motion = self._motion
        if motion.coordinates is None or motion.began:
            available, self.h_s = self.h_s + h_m, 0.0
            self.begin()
            rest = available - self.h_s
            return HoldAccount(Branch.EXIT.value, 0.0, 0.0, max(0.0, -rest), max(0.0, rest))
        self._network.propose(motion.displacement, motion.elapsed)
        touching = self._touches()
        entered, left = touching and not self._touched, self._touched and not touching
        self._touched = touching
        account = None
        if touching and (entered or self._blind or (self.h_s == 0.0 and self.pace == 0.0)):
            account = self._start(h_m, entered)
        if account is None:
            account = self._balance(h_m, damped, power)
        return self._leave(account, touching, left or h_m != 0.0)

    def _start(self, h_m: float, entered: bool) -> HoldAccount | None:
        """First-order start (eq. 14): the state is the model's, and the energy for it is created.

        After it the user feels no torque before `delay` more holds have ended; until then it goes on.
        """
        network, model = self._network, self._model()
        fresh = entered or not self._blind
        if not entered and not self._pushed_inward(model):
            self._blind = 0
            return None
        self._blind = self._delay if fresh else self._blind - 1
        available = self.h_s + h_m
        self.pace = network.share_inside(model) if entered else 1.0
        network.state[:] = model
        network.settle()
        self.h_s = network.energy
        return HoldAccount(Branch.START.value, 0.0, max(0.0, self.h_s - available), 0.0, max(0.0, available - self.h_s))

    def _balance(self, h_m: float, damped: float, power: float) -> HoldAccount:
        """Solves the scalar balance and takes its step; eq. 18 where there is no solution."""
        network, before = self._network, self.h_s
        line = EnergyAlongScale(network.tables, network.user, network.state, network.room.step)
        loss = damped + network.internal
        scale = line.solve(h_m, loss)
        if scale.found and loss * scale.share < 0.0:
            loss = 0.0
            scale = line.solve(h_m, 0.0)
        if not scale.found and h_m <= 0.0:
            return self._approximate(h_m, power, scale.share)
        sticky = h_m > 0.0 and line.taken(0.0, 0.0).slope * scale.share < 0.0
        self._take([scale.share * s for s in network.room.step])
        branch = Branch.STICKY if sticky else Branch.EXACT
        return self._settle(branch, before + h_m, loss * scale.share, scale.share)

    def _approximate(self, h_m: float, power: float, deepest: float) -> HoldAccount:
        """Dissipates what the last velocity would, as far as it is there; the state sinks to what remains (eq. 18).

        Where sinking frees too little, the step is taken to where it gives the most, and the rest is a deficit.
        """
        network, available, model = self._network, self.h_s + h_m, list(self._network.room.step)
        h_r = min(max(0.0, power), max(0.0, available))
        rest, left, empty = self._to_rest(), max(0.0, available) - h_r, available <= 0.0
        line = EnergyAlongScale(network.tables, network.user, network.state, rest)
        bottom = left <= _ROUNDING * self.h_s  # a double root, not to be searched for
        sunk = line.solve(left - self.h_s, 0.0, 1.0)
        if bottom and line.taken(1.0, 0.0).energy <= (_ROUNDING - 1.0) * self.h_s:
            change = rest
        elif sunk.found:
            change = [sunk.share * r for r in rest]
        else:
            change = [deepest * s for s in model]
        self._take(change)
        square = sum([s * s for s in model])
        pace = sum([c * s for c, s in zip(change, model, strict=True)]) / square if square and not empty else 0.0
        return self._settle(Branch.DEPLETED if empty else Branch.FALLBACK, available, h_r, pace)

    def _take(self, change: Sequence[float]) -> None:
        """Changes the state; it does not cross to the other side of a wall that the model touches."""
        network = self._network
        model = self._model()
        for i, c in enumerate(change):
            network.state[i] += c
        for i in network.edged:
            true = extension(network.tables, i, model[i])
            if true * extension(network.tables, i, network.state[i]) <= 0.0 and true != 0.0:
                network.state[i] = network.tables.upper[i] if true > 0.0 else network.tables.lower[i]

    def _settle(self, branch: Branch, available: float, h_r: float, pace: float) -> HoldAccount:
        """Takes the energy of the state; what it leaves over or lacks is booked."""
        self._network.settle()
        self.h_s = h_s = self._network.energy
        self.pace = pace
        rest = available - h_r - h_s
        if abs(rest) <= _ROUNDING * max(abs(available), h_r, h_s):
            rest = 0.0
        return HoldAccount(branch.value, h_r, 0.0, max(0.0, -rest), max(0.0, rest))

    def _leave(self, account: HoldAccount, touching: bool, exchanged: bool) -> HoldAccount:
        """Leaks what is left in storages that the model does not touch any more."""
        network = self._network
        if not network.tables.moving:
            model, before, tables = self._model(), network.energy, network.tables
            for i in network.edged:
                if extension(tables, i, model[i]) == 0.0:
                    upper, lower = tables.upper[i], tables.lower[i]
                    network.state[i] = upper if abs(model[i] - upper) <= abs(model[i] - lower) else lower
            network.settle()
            self.h_s = network.energy
            account = account._replace(leak=account.leak + before - network.energy)
        self.engaged = touching and not self._motion.limit
        if touching:
            return account
        self.pace, self._blind = 0.0, 0
        return account._replace(branch=Branch.EXIT.value if exchanged or account.leak else Branch.FREE.value)

    def _model(self) -> list[float]:
        """Returns the state of the model: where the ports are, or a whole step further."""
        network, coordinates = self._network, self._motion.coordinates
        if network.tables.moving or coordinates is None:
            return [x + s for x, s in zip(network.state, network.room.step, strict=True)]
        return network.at(coordinates)

    def _touches(self) -> bool:
        network = self._network
        if network.always or not network.edged:
            return True
        model = self._model()
        return any(extension(network.tables, i, model[i]) != 0.0 for i in network.edged)

    def _pushed_inward(self, model: list[float]) -> bool:
        """Returns True when the step stores energy at the model's state, or when nothing opposes it there."""
        network = self._network
        efforts = [0.0] * len(model)
        gradient(network.tables, model, efforts)
        if network.user is not None:
            network.user.add_gradient(model, efforts)
        along = sum([e * s for e, s in zip(efforts, network.room.step, strict=True)])
        return along > 0.0 or (along == 0.0 and any(network.room.step))

    def _to_rest(self) -> list[float]:
        """Returns the change of state that takes every storage back to its edge."""
        network = self._network
        return [-extension(network.tables, i, x) for i, x in enumerate(network.state)]

    def efforts(self, holds: int) -> tuple[list[float], list[float], list[float], float]:
        """Returns springs and dampers at the motors, their sum at the ports, and the dampers' power over a hold [J].

        Args:
            holds: That the last motion spanned.
        """
        network, motion = self._network, self._motion
        ports = [self.pace * d / holds for d in motion.displacement]
        dampers = network.dampers(ports, motion.elapsed / holds, self._model())
        springs, _ = network.springs(0.0, 1, ports)
        power = sum([d * c for d, c in zip(dampers, ports, strict=True)])
        whole = [s + d for s, d in zip(springs, dampers, strict=True)]
        return motion.to_motors(springs), motion.to_motors(dampers), whole, power

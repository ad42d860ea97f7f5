from typing import ClassVar

from canhaptic.control.admittance.display_environment import DisplayEnvironment, send
from tests.control.old_forms.stepped import SteppedController, Wording


class DisplayController(SteppedController):
    _environment: DisplayEnvironment
    wording: ClassVar[Wording] = Wording(
        "applied force", "velocity", "encoder, force sensor and their scaling", "mass and damping against the forces"
    )

    @property
    def energy_resolution(self) -> float:
        doubt: float = self._axis.doubt
        return 2.0 * doubt

    def lasted(self, periods: float) -> None:
        state, skipped = (self._state, round(periods) - 1)
        if self._axis.started:
            self._axis.missed += skipped
            own = state.motion.speed - state.slip
            for _ in range(skipped):
                self._environment.go_along(self._memory.inner, own, own, self._settings.motion.sample_time)

    def _command_unseen(self) -> float:
        state, memory = (self._state, self._memory)
        before, state.slip = (state.motion.speed - state.slip, 0.0)
        send(state.motion, memory.commands, 0.0)
        self._environment.go_along(memory.inner, before, 0.0, self._settings.motion.sample_time)
        self._axis.missed += 1
        return 0.0

"""Master and simulated drive through random faults, resets, EMCYs, NMT commands, lost frames and operator's actions.

In any order, after each step: no torque outside OPERATION ENABLED, none beyond its limits of magnitude and rate,
no drive enabled that the operator has not enabled, no energy out of the wall that did not go in, every trouble ends in
a stop in time, and whenever the rig has stopped by itself the drive has no torque already.
"""

import contextlib
import math
from collections.abc import Callable

import can
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties, build_controller
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.control.ports import axis_ports
from canhaptic.cycle import Cycle
from canhaptic.errors import RigError
from canhaptic.signals import PlantEnergy
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drawn import examples
from tests.drive.drive_bench import FreeMass, axis, make_bench

NODE, TPDO, RPDO, SYNC, SDO = 5, 0x185, 0x205, 0x080, 0x605
LIMIT = 8.0  # [N]
STOP_CYCLES = 6
HOLD_CYCLES = 2
MOST_CYCLES = STOP_CYCLES + 2  # between a trouble and the stop
SILENCE = 22  # [cycles]: bus.heartbeat_timeout, and two SYNCs
RATE = 4000.0  # [N/s]: 4 N a cycle
FOR_GOOD = 1 << 30
ROUNDING = 1e-7  # [J]: one count of 10 nm times 8 N, and the sums
BEGIN = 0.002  # [m] in front of the wall


class PushedMass(FreeMass):
    """A free mass of 1 kg with an account of its own: the work of the motor, step by step."""

    def __init__(self) -> None:
        super().__init__()
        self.position = BEGIN
        self.work = 0.0

    def advance_to(self, now: int, torque: float) -> None:
        before = self.position
        super().advance_to(now, torque)
        self.work += torque * (self.position - before)

    def energy(self) -> PlantEnergy:
        return PlantEnergy(self.work, 0.0, 0.0, 0.0)


class RigUnderStress(RuleBasedStateMachine):
    """One axis that renders a wall."""

    @initialize()
    def build(self) -> None:
        self.bench = make_bench(
            [axis(NODE, counts_per_unit=1e8, torque_limit=LIMIT, torque_rate_limit=RATE, speed_limit=20.0)],
            bus={
                "hold_cycles": HOLD_CYCLES,
                "stop_cycles": STOP_CYCLES,
                "heartbeat_period": 0.005,
                "heartbeat_timeout": 0.02,
            },
        )
        self.drive, self.rig = self.bench.drives[0], self.bench.rig
        self.mass = PushedMass()
        self.drive.servo.motor = self.mass
        self.lost = {TPDO: 0, RPDO: 0, 0x705: 0, SYNC: 0, SDO: 0}  # frames still to lose
        self.not_following = 0  # TPDOs still to come without bit 12
        self.most_cycles = MOST_CYCLES  # of the trouble that there is
        self.tamper: Callable[[can.Message], can.Message] | None = None
        self.bench.tampered.on_receive = self._receive
        self.bench.tampered.on_send = self._send
        self.enabled_by_operator = False
        self.trouble: int | None = None  # cycles since the drive was made unfit to go on
        self.cycle: Cycle | None = None
        self.work_before = 0.0

    def teardown(self) -> None:
        if hasattr(self, "bench"):
            with contextlib.suppress(RigError):
                self.rig.stop(ramp=False)
            self.bench.close()

    def _receive(self, message: can.Message) -> can.Message | None:
        if self._is_lost(message):
            return None
        if message.arbitration_id == TPDO and self.not_following and len(message.data) == 8:
            self.not_following -= 1
            message.data[1] &= ~0x10 & 0xFF
        if message.arbitration_id == TPDO and self.tamper is not None:
            tamper, self.tamper = self.tamper, None
            return tamper(message)
        return message

    def _send(self, message: can.Message) -> can.Message | None:
        if message.arbitration_id == RPDO and not self.enabled_by_operator:
            assert bytes(message.data[2:4]) == b"\0\0", "a torque although the operator has stopped"
            assert message.data[0] & 0x0F != 0x0F, "enabled although the operator has stopped"
        return None if self._is_lost(message) else message

    def _is_lost(self, message: can.Message) -> bool:
        left = self.lost.get(message.arbitration_id, 0)
        if left:
            self.lost[message.arbitration_id] = left - 1
        return bool(left)

    def _foreign(self, can_id: int, data: bytes, *, to_drive: bool) -> None:
        bus = self.bench.buses[0 if to_drive else 1]
        bus.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=data))

    @property
    def is_running(self) -> bool:
        return hasattr(self, "rig") and self.rig.is_running

    # --- the operator -------------------------------------------------------------------------------------------------

    @precondition(lambda self: not self.is_running)
    @rule(reset=st.sampled_from([True, True, True, False]))
    def start(self, reset: bool) -> None:
        if reset:
            self.reset_faults()
        self.trouble, self.most_cycles = None, MOST_CYCLES
        self.lost, self.not_following = dict.fromkeys(self.lost, 0), 0
        self.enabled_by_operator = True
        loop = LoopProperties(sample_time=1e-3, delay=1, moving_mass=1.0, device_damping_bound=0.0, torque_limit=LIMIT)
        wall = SpringDamperWall(stiffness=300.0, damping=1.0)
        parameters = GuardedParameters(max_consecutive_losses=16)
        try:
            self.rig.start()
        except RigError:
            self.enabled_by_operator = False
            return
        self.cycle = Cycle(self.rig, axis_ports([build_controller(wall, "guarded", parameters, loop)]))
        self.work_before = self.mass.work

    @precondition(lambda self: self.is_running)
    @rule(ramp=st.booleans())
    def stop(self, ramp: bool) -> None:
        with contextlib.suppress(RigError):
            self.rig.stop(ramp=ramp)
        self.enabled_by_operator = False

    def reset_faults(self) -> None:
        with contextlib.suppress(RigError):
            self.rig.reset_faults()
        self.check_enabled()

    @rule(speed=st.floats(0.0, 0.4))
    def push(self, speed: float) -> None:
        """The hand gives the mass a blow towards the wall: never along the torque."""
        self.mass.velocity = max(-1.0, self.mass.velocity - speed)

    # --- time ---------------------------------------------------------------------------------------------------------

    @precondition(lambda self: self.is_running)
    @rule(cycles=st.integers(1, 5))
    def run_a_little(self, cycles: int) -> None:
        self.run(cycles)

    @precondition(lambda self: self.is_running)
    @rule(cycles=st.integers(20, 80), speed=st.floats(0.0, 0.4))
    def push_and_run(self, cycles: int, speed: float) -> None:
        self.push(speed)
        self.run(cycles)

    def run(self, cycles: int) -> None:
        assert self.cycle is not None
        try:
            for _ in range(cycles):
                self.cycle.step()
                self._check_cycle()
        except RigError:
            assert not self.rig.is_running
            assert self.drive.torque == 0.0, "the rig has stopped, the torque stays"
            assert self.drive.state is not DriveState.OPERATION_ENABLED
            self.enabled_by_operator = False
            self.cycle = None

    def _check_cycle(self) -> None:
        """Holds after each cycle, not only after each step."""
        assert self.cycle is not None
        self.check_torque()
        if self.trouble is not None:
            self.trouble += 1
            assert self.trouble <= self.most_cycles, "the rig runs on"
        self._check_rate()
        if self.rig.records[-1].samples[0].fresh:
            accounted, true = self.cycle.ledgers[0].interaction, self.work_before - self.mass.work
            uncertainty = (
                self.cycle.meters.ports[0].measured().energy_resolution
            )  # a lost position hides a torque's end
            assert accounted <= true + uncertainty + ROUNDING, "more was booked than came in"
            # after a lost sample the booked energy is a worst case and may fall below what came in; the true one not
            assert true >= -ROUNDING, "more was given out than came in"

    def _check_rate(self) -> None:
        """No torque rises, on either side of zero, by more than its rate allows; per mille of 10 N."""
        sent = [record.torques_per_mille[0] for record in list(self.rig.records)[-2:]]
        before, now = sent if len(sent) == 2 else [0, *sent]
        rise = abs(now) - (abs(before) if before * now > 0 else 0)
        assert rise <= RATE * 1e-3 * 100 + 1

    @precondition(lambda self: not self.is_running)
    @rule(milliseconds=st.integers(1, 200))
    def wait(self, milliseconds: int) -> None:
        self.bench.links[0].pump(self.bench.clock.now() + milliseconds * 1_000_000)

    # --- trouble ------------------------------------------------------------------------------------------------------

    @precondition(lambda self: self.is_running)
    @rule(code=st.sampled_from([0x2310, 0x4310, 0x7305, 0x8611]))
    def fault(self, code: int) -> None:
        if self.drive.state is DriveState.OPERATION_ENABLED:
            self.trouble = 0
        self.drive.inject_fault(code)

    @precondition(lambda self: self.is_running)
    @rule(code=st.integers(1, 0xFFFF), length=st.integers(2, 8))
    def emergency(self, code: int, length: int) -> None:
        self._foreign(0x080 + NODE, code.to_bytes(2, "little").ljust(length, b"\1"), to_drive=False)
        if self.is_running:
            self.trouble = 0

    @rule(command=st.sampled_from([0x01, 0x02, 0x80, 0x81, 0x82]), node=st.sampled_from([0, NODE, 7]))
    def command_of_another_master(self, command: int, node: int) -> None:
        self._foreign(0x000, bytes([command, node]), to_drive=True)
        if self.is_running and command != 0x01 and node != 7:
            self.trouble = 0

    @rule(value=st.sampled_from([0x00, 0x06, 0x07, 0x02]))
    def controlword_of_another_master(self, value: int) -> None:
        """By SDO: disables or quick-stops; the RPDO of a running rig may enable again what never left its side."""
        self._foreign(0x600 + NODE, bytes([0x2B, 0x40, 0x60, 0x00, value, 0, 0, 0]), to_drive=True)

    @precondition(lambda self: self.is_running)
    @rule(can_id=st.sampled_from([TPDO, RPDO, 0x705]), count=st.integers(1, 3))
    def lose(self, can_id: int, count: int) -> None:
        if self.trouble is None and not any(self.lost.values()):
            self.lost[can_id] = count

    @precondition(lambda self: self.is_running and self.trouble is None and not any(self.lost.values()))
    @rule(
        lost=st.sampled_from([(TPDO,), (RPDO,), (SYNC,), (RPDO, SDO), (RPDO, SYNC, SDO), (TPDO, 0x705), (0x705,)]),
        cycles=st.integers(1, 60),
    )
    def lose_for_good(self, lost: tuple[int, ...], cycles: int) -> None:
        """Nothing of this kind arrives any more. A lost RPDO shows only once the torque changes."""
        self.lost |= dict.fromkeys(lost, FOR_GOOD)
        if RPDO not in lost or SYNC in lost:
            self.trouble = 0
            self.most_cycles = SILENCE if lost == (0x705,) else MOST_CYCLES
        self.run(cycles)

    @precondition(lambda self: self.is_running)
    @rule(cycles=st.integers(1, 6))
    def follow_no_more(self, cycles: int) -> None:
        """Bit 12 goes out for a while."""
        self.not_following = cycles
        if cycles > HOLD_CYCLES and self.trouble is None and not any(self.lost.values()) and self.tamper is None:
            self.trouble = 0  # a TPDO that is still to be damaged takes one of them away
        self.run(cycles)

    @precondition(lambda self: self.is_running)
    @rule(torque=st.sampled_from([math.nan, math.inf, -math.inf]))
    def break_the_controller(self, torque: float) -> None:
        """No torque that is no number: the rig stops within the call."""
        with contextlib.suppress(RigError):
            self.rig.sync()
            self.rig.write_torques([torque])
        assert not self.rig.is_running
        assert self.drive.torque == 0.0
        self.enabled_by_operator, self.cycle = False, None

    @precondition(lambda self: self.is_running)
    @rule(index=st.sampled_from([0x6502, 0x1008, 0x60FF]), count=st.integers(1, 3))
    def ask_beside_the_cycle(self, index: int, count: int) -> None:
        for _ in range(count):
            self.rig.sdo(0).upload(index)

    @precondition(lambda self: self.is_running)
    @rule(kind=st.sampled_from(["short", "long", "remote", "extended", "foreign"]))
    def damage(self, kind: str) -> None:
        def tamper(message: can.Message) -> can.Message:
            if kind in ("short", "long"):
                message.data = message.data[:5] if kind == "short" else message.data + b"\0"
            elif kind == "foreign":
                message.arbitration_id = 0x3AB
            else:
                message = can.Message(
                    timestamp=message.timestamp, arbitration_id=message.arbitration_id, data=message.data,
                    is_extended_id=kind == "extended", is_remote_frame=kind == "remote",
                )  # fmt: skip
            return message

        self.tamper = tamper

    @rule(can_id=st.sampled_from([TPDO, 0x585, 0x123]), data=st.binary(max_size=8))
    def noise(self, can_id: int, data: bytes) -> None:
        """Any frame, outside the window of a SYNC."""
        self._foreign(can_id, data, to_drive=False)

    @rule()
    def heartbeat_of_another_state(self) -> None:
        """Stops the rig unless the next heartbeat comes before anybody looked."""
        self._foreign(0x705, b"\x7f", to_drive=False)

    # --- what must hold -----------------------------------------------------------------------------------------------

    @invariant()
    def check_torque(self) -> None:
        if not hasattr(self, "drive"):
            return
        assert abs(self.drive.torque) <= LIMIT
        if self.drive.state is not DriveState.OPERATION_ENABLED:
            assert self.drive.torque == 0.0
        sent = self.rig.records[-1].torques_per_mille if self.rig.records else [0]
        assert abs(sent[0]) <= LIMIT / 10.0 * 1000.0

    @invariant()
    def check_enabled(self) -> None:
        if hasattr(self, "drive") and not self.enabled_by_operator:
            assert self.drive.state is not DriveState.OPERATION_ENABLED


def _case(most: int, steps: int) -> settings:
    return settings(
        max_examples=examples(most),
        stateful_step_count=steps,
        deadline=None,
        derandomize=True,
        phases=(Phase.generate,),  # an example is readable as it is, and shrinking one takes minutes
        suppress_health_check=list(HealthCheck),
    )


class RigUnderLongStress(RigUnderStress):
    """The same for longer."""


TestRigUnderStress = RigUnderStress.TestCase
TestRigUnderStress.settings = _case(60, 40)
TestRigUnderLongStress = pytest.mark.slow(pytest.mark.timeout(900)(RigUnderLongStress.TestCase))
TestRigUnderLongStress.settings = _case(500, 50)

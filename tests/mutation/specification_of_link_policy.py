"""What `canhaptic.drive.safety.link_policy` must do: decision table, numbers in the log, shares by hand."""

from types import ModuleType

from canhaptic.errors import (
    BusFailedError,
    CommandLostError,
    CycleFailedError,
    DriveStateFaultError,
    EmergencyError,
    EnergyLostError,
    EnergyUncertainError,
    ForceContradictedError,
    ForceFrozenError,
    ForceRangeError,
    FramesLostError,
    HeartbeatLostError,
    HoldsContradictedError,
    NmtStateLeftError,
    NotFollowingError,
    OwnCodeLateError,
    PositionJumpError,
    SecondMasterError,
    StateLeftError,
    SyncsSkippedError,
    TorqueContradictedError,
    TorqueLimitedError,
    TorqueNotFiniteError,
    TpdoContradictedError,
    TpdoLostError,
)

REASONS = {  # the numbers are in logs that exist
    "NONE": 0,
    "OPERATOR": 1,
    "TPDO_LOST": 10,
    "HEARTBEAT_LOST": 11,
    "SEND_FAILED": 12,
    "COMMAND_LOST": 13,
    "SECOND_MASTER": 14,
    "SYNCS_SKIPPED": 15,
    "FRAMES_LOST": 16,
    "TPDO_CONTRADICTED": 17,
    "HOLDS_CONTRADICTED": 18,
    "EMERGENCY": 20,
    "DRIVE_FAULT": 21,
    "STATE_LEFT": 22,
    "NMT_STATE_LEFT": 23,
    "POSITION_JUMP": 24,
    "NOT_FOLLOWING": 25,
    "TORQUE_LIMITED": 26,
    "FORCE_RANGE": 27,
    "FORCE_FROZEN": 28,
    "TORQUE_CONTRADICTED": 29,
    "CONTROLLER": 30,
    "EXCEPTION": 31,
    "ENERGY_LOST": 32,
    "FORCE_CONTRADICTED": 33,
    "OWN_CODE_LATE": 34,
    "ENERGY_UNCERTAIN": 35,
}
RAISED = {
    "TPDO_LOST": TpdoLostError,
    "HEARTBEAT_LOST": HeartbeatLostError,
    "SEND_FAILED": BusFailedError,
    "COMMAND_LOST": CommandLostError,
    "SECOND_MASTER": SecondMasterError,
    "SYNCS_SKIPPED": SyncsSkippedError,
    "EMERGENCY": EmergencyError,
    "DRIVE_FAULT": DriveStateFaultError,
    "STATE_LEFT": StateLeftError,
    "NMT_STATE_LEFT": NmtStateLeftError,
    "POSITION_JUMP": PositionJumpError,
    "NOT_FOLLOWING": NotFollowingError,
    "TORQUE_LIMITED": TorqueLimitedError,
    "FORCE_RANGE": ForceRangeError,
    "FORCE_FROZEN": ForceFrozenError,
    "CONTROLLER": TorqueNotFiniteError,
    "EXCEPTION": CycleFailedError,
    "ENERGY_LOST": EnergyLostError,
    "FORCE_CONTRADICTED": ForceContradictedError,
    "OWN_CODE_LATE": OwnCodeLateError,
    "FRAMES_LOST": FramesLostError,
    "TPDO_CONTRADICTED": TpdoContradictedError,
    "HOLDS_CONTRADICTED": HoldsContradictedError,
    "TORQUE_CONTRADICTED": TorqueContradictedError,
    "ENERGY_UNCERTAIN": EnergyUncertainError,
}
CASES = (
    # hold, and whether the torque is held at 0, 1, 2, ... missed
    (2, (True, True, True, False, False)),
    (0, (True, False, False)),
    (1, (True, True, False)),
    (3, (True, True, True, True, False, False)),
)


def judge(module: ModuleType) -> None:
    """Raises when the module is not what its table says."""
    assert {reason.name: int(reason) for reason in module.StopReason} == REASONS
    assert {reason.name: rule.error for reason, rule in module.STOP_TABLE.items()} == RAISED
    for name, error in RAISED.items():
        assert module.reason_of(error("")).name == name
    assert module.reason_of(ValueError("")).name == "EXCEPTION"
    for hold, held in CASES:
        policy = module.LinkPolicy(hold, 6, 0.1, 1000.0)
        for missed, is_held in enumerate(held):
            assert (policy.missed, policy.missed_total, policy.cycles) == (missed, missed, missed)
            assert policy.is_held is is_held
            policy.on_missed()
    _counts(module)


def _counts(module: ModuleType) -> None:
    policy = module.LinkPolicy(2, 6, 0.1, 1000.0)
    assert policy.success_rate() == 1.0
    seen = []
    for heard in (True, False, False, True, False, True, True, True):
        (policy.on_tpdo if heard else policy.on_missed)()
        seen.append((policy.cycles, policy.missed, policy.missed_total, policy.success_rate()))
    assert seen == [
        (1, 0, 0, 1.0),
        (2, 1, 1, 1 / 2),
        (3, 2, 2, 1 - 2 / 3),
        (4, 0, 2, 1 / 2),
        (5, 1, 3, 1 - 3 / 5),
        (6, 0, 3, 1 / 2),
        (7, 0, 3, 1 - 3 / 7),
        (8, 0, 3, 5 / 8),
    ]
    policy.on_missed()
    policy.reset()
    assert (policy.cycles, policy.missed, policy.missed_total, policy.success_rate()) == (0, 0, 0, 1.0)
    _budget(module)


def _budget(module: ModuleType) -> None:
    budget = module.LossBudget(0.25, 2.0)
    seen = [(budget.lose(at), budget.level) for at in (4, 5, 6, 16)]
    assert seen == [(False, 1.0), (False, 1.75), (True, 2.5), (False, 1.0)]
    assert (budget.lose(17, 1.5), budget.level) == (True, 2.25)
    budget.reset()
    assert budget.level == 0.0
    assert (budget.lose(0, 2.0), budget.level) == (False, 2.0)
    for rate, stop, most in ((1000.0, 20, 20), (40.0, 20, 10), (60.0, 20, 15), (1000.0, 400, 250), (1000.0, 6, 10)):
        policy = module.LinkPolicy(2, stop, 0.0, rate)
        for _ in range(2):
            spent = []
            for _ in range(most + 1):  # every second SYNC: never two in a row
                policy.on_tpdo()
                policy.on_missed()
                spent.append(policy.lose())
            assert spent == [False] * most + [True]
            policy.reset()
    policy, spent = module.LinkPolicy(2, 40, 0.0, 40.0), []
    for _ in range(41):  # in a row, of which `stop_cycles` has the say
        policy.on_missed()
        spent.append(policy.lose())
    assert spent == [False] * 40 + [True]
    policy, since = module.LinkPolicy(2, 40, 0.5, 40.0), []
    for lost in (False, False, True, False, True):
        policy.on_tpdo()
        if lost:
            policy.lose()
        since.append(policy.lost_since)
    assert since == [1, 2, 0, 1, 0]

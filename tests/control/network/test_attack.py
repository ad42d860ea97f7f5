"""Groups under attack on exact plants: no user within what is declared takes energy out; those beyond it do."""

import random
from dataclasses import replace

import pytest

from canhaptic.control.mechanisms.five_bar import FiveBar as FiveBarKinematics
from canhaptic.control.multi_axis import build_group_controller
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.control.port_hamiltonian.shapes.anisotropic_spring import AnisotropicSpring
from canhaptic.control.port_hamiltonian.shapes.box import Box
from canhaptic.control.port_hamiltonian.shapes.coupled_handles import CoupledHandles
from canhaptic.control.port_hamiltonian.shapes.plane import Plane
from canhaptic.sim.plant.mechanism.five_bar_linkage import FiveBarLinkage
from canhaptic.sim.plant.mechanism.task_hand import PlaneMotion, TaskHand
from canhaptic.sim.plant.user import SinusoidMotion
from canhaptic.units import Parameters
from tests.adversary.group import (
    Attack,
    Losses,
    before_moving_wall,
    dragged,
    in_space,
    late,
    random_attack,
    run,
)

LOSSES = {"lost_commands": 0.3, "lost_samples": 0.1}
KINDS = {
    "together": {},
    "counts, quanta and known limits": {"count": 1e-5, "quantum": 0.01, "limits": (0.5, 5.0)},
    "commands of one axis lost": {"lost_commands": 0.3, "max_consecutive_losses": 1},
    "samples lost": {"lost_samples": 0.2, "max_consecutive_losses": 1},
    "any frame lost": {**LOSSES, "max_consecutive_losses": 1, "delay": 1},
    "both lost, twice in a row": {**LOSSES, "max_consecutive_losses": 2, "count": 1e-5},
    "friction of one axis": {
        "friction": (5.0, 0.0), "declared_friction": 5.0, "coupling": ((0.0, 0.0), (0.0, 0.0)), "delay": 1,
    },
    "masses of 100 to 1, frames lost": {
        **LOSSES, "max_consecutive_losses": 3, "masses": (0.02, 2.0), "coupling": ((0.0, 0.0), (0.0, 0.0)),
    },
    "three axes": {},
    "three axes, frames lost": {**LOSSES, "max_consecutive_losses": 2},
    "a wall that moves": {},
    "a wall that moves, frames lost": {**LOSSES, "max_consecutive_losses": 2},
    "a hand of declared speed, frames lost": {**LOSSES, "max_consecutive_losses": 2},
    "late": {},
    "late, frames lost": {**LOSSES, "max_consecutive_losses": 2},
}  # fmt: skip
MADE = {
    "late": late, "late, frames lost": late,
    "three axes": in_space, "three axes, frames lost": in_space, "a wall that moves": before_moving_wall,
    "a wall that moves, frames lost": before_moving_wall,
    "a hand of declared speed, frames lost": dragged,
}  # fmt: skip


def attack_of(kind, rng, cycles=150):
    attack = random_attack(rng, cycles=cycles, **KINDS[kind])  # type: ignore[arg-type]
    return MADE[kind](attack, rng) if kind in MADE else attack


def search(kind, runs, cycles=150):
    """Returns (least true sum of h_i and credit [J], how many runs rendered a torque worth the name)."""
    least, rendered = 0.0, 0
    for seed in range(runs):
        rng = random.Random(f"{kind}{seed}")
        attack = attack_of(kind, rng, cycles)
        given, strongest = run(attack, rng)
        least, rendered = min(least, given + attack.own.get("energy_allowance", 0.0)), rendered + (strongest > 0.1)
    return least, rendered


@pytest.mark.slow_but("together", "any frame lost", "counts, quanta and known limits")
@pytest.mark.parametrize("kind", KINDS)
def test_no_attack_within_the_promise_takes_energy_out(kind):
    least, rendered = search(kind, 6, 100)
    assert least >= -1e-9
    assert rendered >= 2


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.campaign_for("*-1500")
@pytest.mark.parametrize("runs", [100, 1500])
@pytest.mark.parametrize("kind", KINDS)
def test_no_attack_of_many_within_the_promise_takes_energy_out(kind, runs):
    least, rendered = search(kind, runs, 250)
    assert least >= -1e-9
    assert rendered >= runs // 3


# --- attacks that took energy out before their cure ------------------------------------------------------------------


@pytest.mark.parametrize("seed", ["together111", "together349", "together55"])
def test_two_hands_may_each_pull_with_the_declared_force(seed):
    """15.6, 3.2 and 0.2 mJ came out while the force along the torque of the group alone was counted."""
    rng = random.Random(seed)
    least, strongest = run(random_attack(rng), rng)
    assert strongest > 1.0
    assert least >= -1e-9


def test_friction_of_one_axis_is_not_hidden_by_the_motion_of_another():
    """Sliding along an oblique wall one axis gives and the other takes: 0.11 mJ beyond the credit came out."""
    rng = random.Random("friction76")
    attack = random_attack(
        rng, delay=1, hand_force=0.0, friction=(5.0, 0.0), declared_friction=5.0, masses=(1.0, 1.0),
        coupling=((0.0, 0.0), (0.0, 0.0)), own={"energy_allowance": 1e-3},
    )  # fmt: skip
    least, _ = run(attack, rng)
    assert least >= -1e-3 - 1e-9


@pytest.mark.slow_but("68", "202")
@pytest.mark.parametrize("seed", [51, 68, 202, 218])
def test_what_a_mover_takes_of_a_torque_under_way_is_kept_for_it(seed):
    """0.05, 1.7, 2.6 and 2.2 mJ came out while it was certified with the torque and then spent on the next one."""
    rng = random.Random(f"a wall that moves{seed}")
    attack = before_moving_wall(random_attack(rng, cycles=250, delay=1), rng)
    assert run(attack, rng)[0] >= -1e-9


OBLIQUE = AnisotropicSpring(centre=(0.0, 0.0), stiffness=((4e3, 1.9e3), (1.9e3, 1e3)))
SLIDING = Attack(OBLIQUE, sample_time=2e-3, delay=1, start=(0.03, 0.03), parts=1, cycles=120)


@pytest.mark.slow_but("lost_samples")
@pytest.mark.parametrize(
    "apart", [{"cuts": (1.0, 1e9)}, {"lost_commands": 0.4}, {"lost_samples": 0.45}], ids=lambda apart: next(iter(apart))
)
def test_axes_that_act_apart_give_out_energy_unless_that_is_declared(apart):
    """A limiter, a lost RPDO or a lost TPDO of one axis turns the torque of the group."""
    least = {0: 0.0, 1: 0.0}
    for seed in range(12):
        rng = random.Random(seed)
        velocity = -rng.uniform(0.5, 3.0), rng.uniform(-2.0, 2.0)
        for declared in least:
            attack = replace(SLIDING, velocity=velocity, **apart)
            if "cuts" in apart:
                attack = replace(attack, limits=attack.cuts if declared else None)
            else:
                attack = replace(attack, max_consecutive_losses=declared)
            least[declared] = min(least[declared], run(attack, rng)[0])
        if seed >= 3 and least[0] < -1e-4:
            break
    assert least[0] < -1e-4
    assert least[1] >= -1e-9


def test_drawn_losses_of_either_kind_count_together():
    """Three cycles in a row without a new torque, a sample and then two commands, are more than two losses.

    Seed 535 of a search that counted samples and commands apart: the torque stayed for a fourth hold, for which nothing
    was stored any more, and 0.2 mJ came out.
    """
    attack, longest = Attack(OBLIQUE, max_consecutive_losses=2, delay=1, lost_commands=0.5, lost_samples=0.5), 0
    for seed in range(40):
        losses, due, without = Losses(attack, random.Random(seed)), [True], [0, 0]
        for cycle in range(60):
            due.append(not losses.sample(cycle))
            new = due.pop(0)
            for axis in range(2):
                without[axis] = without[axis] + 1 if losses.command(axis) or not new else 0
            longest = max(longest, *without)
    assert longest == 2


@pytest.mark.slow
@pytest.mark.parametrize("beyond", ["mass", "force", "losses"])
def test_attacks_beyond_the_promise_succeed(beyond):
    """The search has teeth: masses over-declared, a hand stronger than declared, one loss more: it finds energy."""
    least = 0.0
    for seed in (119, *range(30)):  # few find what one loss more gives out
        rng = random.Random(seed)
        attack = random_attack(rng, delay=1, hand_force=4.0, coupling=((0.0, 0.0), (0.0, 0.0)), friction=(0.0, 0.0))
        if beyond == "force":
            attack = replace(attack, pulls=2.0)
        elif beyond == "losses":
            attack = replace(attack, max_consecutive_losses=1, in_a_row=2, lost_commands=0.3, lost_samples=0.3)
        else:
            lighter = tuple(-0.4 * m for m in attack.masses)
            attack = replace(attack, coupling=((lighter[0], 0.0), (0.0, lighter[1])))
        least = min(least, run(attack, rng)[0])
        if least < -1e-5:
            break
    assert least < -1e-5


def test_lost_frames_cost_stiffness_and_nothing_when_not_declared():
    """At rest in a stiff spring the torque that is held goes down with every loss to survive."""
    held = []
    for losses in (0, 1, 2):
        attack = Attack(
            Box(stiffness=1e5, lower=(-0.01, -0.01), upper=(0.01, 0.01)), start=(0.009, 0.0), velocity=(0.5, 0.0),
            max_consecutive_losses=losses, cycles=40,
        )  # fmt: skip
        held.append(run(attack, random.Random(0))[1])
    assert held[0] > held[1] > held[2] > 1.0


def test_a_group_of_too_many_losses_is_refused():
    with pytest.raises(ValueError, match="16"):
        GuardedParameters(max_consecutive_losses=17)


# --- mechanisms -------------------------------------------------------------------------------------------------------

LINKS = {"base": 0.1, "proximal": 0.15, "distal": 0.2}


def five_bar_run(environment: Parameters, delay: int, rate: int, cycles: int, angles, amplitude, stiffness=150.0):
    """Returns (least true sum of h_i [J], strongest torque, fastest motor [rad/s])."""
    sample_time_ns = round(1e9 / rate)
    hand = TaskHand(
        stiffness=stiffness, damping=1.0, rest=(0.0, 0.27),
        motion=PlaneMotion(
            x=SinusoidMotion(amplitude=amplitude, frequency=3.1), y=SinusoidMotion(amplitude=amplitude, frequency=4.3)
        ),
    )  # fmt: skip
    plant = FiveBarLinkage(
        **LINKS, motor_inertia=1.2e-3, distal_mass=0.04, handle_mass=0.05, initial_angles=angles,
        elbow_stop={"least": 0.05, "most": 0.39, "stiffness": 5e3},
    ).build(hand, sample_time_ns, 4)  # fmt: skip
    kinematics = FiveBarKinematics(
        base=0.1, proximal=(0.15, 0.15), distal=(0.2, 0.2), least_sine=0.15
    )  # fmt: skip
    loop = LoopProperties(sample_time=1.0 / rate, delay=delay, moving_mass=1.2e-3, device_damping_bound=0.0)
    own = GuardedParameters(hand_force=2.0)
    controller = build_group_controller(environment, kinematics, "guarded", own, [loop, loop])  # type: ignore[arg-type]
    held: tuple[float, ...] = (0.0, 0.0)
    pending = [held] * delay
    least = strongest = fastest = 0.0
    plant.begin(0)
    for cycle in range(cycles):
        balance = controller.step(plant.positions, held)
        pending.append(balance.torques)
        held = pending.pop(0)
        plant.advance_to((cycle + 1) * sample_time_ns, held)
        given = -sum(plant.energy(axis).motor for axis in (0, 1))
        least, strongest = min(least, given), max(strongest, *map(abs, held))
        fastest = max(fastest, *map(abs, plant.velocities))
    return least, strongest, fastest


FIVE_BARS = {
    "plane": Plane(normal=(0.6, 0.8), offset=0.2, stiffness=2000.0, damping=2.0),
    "stiff": Box(stiffness=1e6, lower=(-0.02, 0.24), upper=(0.02, 0.29)),
    "spring": AnisotropicSpring(centre=(0.02, 0.27), stiffness=((3e3, 1e3), (1e3, 1e3))),
}


@pytest.mark.slow_but("stiff-0")
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("environment", FIVE_BARS)
def test_a_fast_five_bar_near_its_singular_poses_gives_out_nothing(environment, delay):
    """Inertia is coupled and changes with the pose; its forces are part of the declared hand force."""
    least, strongest, fastest = five_bar_run(FIVE_BARS[environment], delay, 1000, 250, (2.0, 1.14), 0.06)
    assert fastest > 5.0
    assert strongest > 0.01
    assert least >= -1e-9


def test_two_handles_pulled_apart_with_the_declared_force_each():
    attack = Attack(
        CoupledHandles(stiffness=2e4), sample_time=4e-3, delay=0, hand_force=8.0, start=(0.02, -0.02), cycles=200,
        masses=(0.4, 0.4), velocity=(-1.0, 1.0),
    )  # fmt: skip
    for seed in range(6):
        assert run(attack, random.Random(seed))[0] >= -1e-9

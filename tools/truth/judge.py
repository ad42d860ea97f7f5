"""Runs a scene and compares what its account claims with what the simulated plant really took and gave.

A claim is false when

    error         |believed - true| sum of interaction is larger than the energy resolution that is stated, or 1.1
                  times one that the account calls an estimate
    estimate      the account says yes or no and calls its resolution an estimate
    passive yes   and the true sum fell below minus that resolution and the allowance
    passive no    and the true sum never fell below minus the allowance, or a later account says something else
    certificate   is named that the scene does not declare, or with a true sum below minus that resolution

after any hold, by the resolution of that hold: the account is judged at every moment and not at the end alone.
"""

import copy
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from math import inf
from typing import Any, Final

from canhaptic.commission.torque_tests import checked_holds
from canhaptic.control.verdict import NOT_CHECKED, UNDECIDED
from canhaptic.cycle import Cycle, run
from canhaptic.errors import CanHapticError
from canhaptic.result import RunResult, run_result
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import scene_from_mapping
from canhaptic.scene.models import Scene
from tools.truth.faults import FaultWatch
from tools.truth.hand_watch import HandWatch
from tools.truth.loss_watch import LossWatch
from tools.truth.programs import Asking
from tools.truth.scenes import SOURCE, TruthScene
from tools.truth.stops import claims_after, left_after, promises_broken_after

ROUNDING: Final = 1e-9
"""Energy that counts as none [J]."""
TOUCH: Final = 0.5
"""Force of a contact that counts [N]."""
LOSS_LIMIT: Final = 0.01
"""Energy given out beyond what is declared at which a rig stops by default [J]."""
_MOST_LOSSES: Final = 4
"""Cycles in a row with a loss that a scene declares, once its bus has really lost so many."""
_UNCHECKED: Final = "hold:not_checked"
_UNDECIDED: Final = "hold:undecided"
_UNCONFIRMED: Final = "end:unconfirmed"
_PROMISES_NO_YES: Final = frozenset(("timing:stall", _UNCHECKED, _UNDECIDED, _UNCONFIRMED))
"""A host that stalls makes a hold longer than is declared; of a hold that nothing has found no account says yes; nor
where a drive with a torque has not confirmed at the end that it is disabled."""
_TRIES: Final = 4
_DECLARED_BY: Final = {"velocity_loop": "loop_gain"}
"""Certificate -> key that declares what it rests on, where that has another name."""
_ESTIMATE: Final = 1.1
"""Factor within which a resolution that the account calls an estimate has to be right; no verdict may rest on it."""
FINE: Final = 1.0 / 20.0
"""Resolution over the energy that came in below which a yes is due."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one run claimed, and what was true. Energies in [J]."""

    seed: int
    tags: tuple[str, ...]
    status: str  # "completed", "stopped", or "refused" by the scene's own checks
    verdict: str  # passive at the motor, of the worst port
    at_handle: str
    certificates: tuple[str, ...]
    resolution: float  # of the worst port, as its error over its resolution goes
    error: float  # of the same port
    least: float  # true sum of interaction, of the worst port
    peak: float  # largest torque that was sent [N]
    asked: float  # largest effort that the environment asked for [N]
    declared: bool  # whether hand force and push were within what was declared
    false_claims: tuple[str, ...]
    text: str = ""
    reaction: str = ""  # why the rig stopped
    to_zero: int = 0  # sample times from a fault until no drive gave a torque any more
    lost: float = 0.0  # true energy given out beyond what is declared and the resolution, of the worst port [J]
    losses: int = 0  # most cycles in a row in which a bus lost process data
    declared_losses: int = 0  # of these that are declared
    skipped: int = 0  # SYNCs that the rig left out
    given_after: float = 0.0  # true energy that a motor gave after the last hold of the account, of the worst axis [J]
    open_share: float = 0.0  # resolution over the energy that came in, of the worst port

    @property
    def counts(self) -> bool:
        """Whether it ran for long enough and touched; without a torque it proves nothing."""
        return self.status == "completed" and self.peak > 0.0 and max(self.peak, self.asked) >= TOUCH

    @property
    def is_due(self) -> bool:
        """Whether a yes is due; `tools/bench/truth.py` says when."""
        if _PROMISES_NO_YES.intersection(self.tags):
            return False
        touched = self.status != "refused" and self.peak > 0.0 and max(self.peak, self.asked) >= TOUCH
        is_within = self.losses <= self.declared_losses and not self.skipped and self.open_share < FINE
        return touched and is_within and self.declared and "algorithm:guarded" in self.tags and self.least >= -ROUNDING

    @property
    def says_yes(self) -> bool:
        """Whether the account promises the sum at motor or handle; a port without any torque needs no certificate."""
        return "yes" in (self.verdict, self.at_handle) and (bool(self.certificates) or self.peak == 0.0)

    @property
    def went_on(self) -> bool:
        """Whether it gave out more than declared, by more than the limit that stops a run, and was not stopped."""
        return self.status == "completed" and self.lost > LOSS_LIMIT and "algorithm:guarded" in self.tags

    @property
    def is_silent(self) -> bool:
        """Whether something asked for a force and none was rendered."""
        return self.status == "completed" and self.asked >= TOUCH and self.peak < 0.1 * TOUCH

    def as_json(self) -> dict[str, Any]:
        """Returns all fields as plain values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "Outcome":
        """Returns what `as_json` wrote; JSON knows no tuples."""
        plain: dict[str, Any] = {k: tuple(value) if isinstance(value, list) else value for k, value in values.items()}
        return cls(**plain)


Make = Callable[[Scene], Experiment]
"""Builds a scene."""


def _on_its_bus(scene: Scene) -> Experiment:
    return build(scene, "free")


def judged(scene: TruthScene, make: Make = _on_its_bus) -> tuple[TruthScene, Outcome]:
    """Returns the scene with its declarations raised to what hand and bus did, and the outcome of its run.

    Losses of the bus are declared up to `_MOST_LOSSES`.

    Args:
        scene: The scene.
        make: Builds it.
    """
    outcome, watch = _run(scene, make)
    survives = scene.promises and "drive:after_update" not in scene.tags  # refused there
    for _ in range(_TRIES):
        more_losses = survives and outcome.declared_losses < outcome.losses <= _MOST_LOSSES
        if watch is None or not scene.is_true or (outcome.declared and not more_losses):
            break
        scene = _with_true_hand(scene, watch)
        if more_losses:
            scene.passivity["max_consecutive_losses"] = outcome.losses
        outcome, watch = _run(scene, make)
    return scene, outcome


def _with_true_hand(scene: TruthScene, watch: HandWatch) -> TruthScene:
    values = copy.deepcopy(scene.values)
    raised = replace(scene, values=values)
    section = raised.passivity
    for key, seen in _of_hand(watch).items():
        if section.get(key) is not None and seen > section[key]:
            section[key] = float(f"{1.2 * seen:.4g}")
    return raised


def _of_hand(watch: HandWatch) -> dict[str, float]:
    """Returns what a scene may declare of the hand, as it really was."""
    return {"hand_force": max(watch.pull), "hand_push": max(watch.push), "hand_speed": max(watch.speed)}


def _run(scene: TruthScene, make: Make) -> tuple[Outcome, HandWatch | None]:
    """Returns what a run came to, and who watched its hand; None where the scene was refused."""
    try:
        loaded = checked_holds(scene_from_mapping(scene.values, SOURCE), lambda text: None, lambda: False)
        experiment = make(loaded)
    except CanHapticError as error:
        return _refused(scene, str(error)), None
    status, text, reaction, to_zero = "completed", "", "", 0
    with experiment:
        watch, asked, faults = HandWatch(experiment, scene.outward), _Asked(experiment), FaultWatch(experiment, scene)
        losses = LossWatch(experiment)
        moments = _Moments(experiment, scene.passivity, has_twin="fault:twin" in scene.tags)
        program = next((tag.partition(":")[2] for tag in scene.tags if tag.startswith("program:")), "")
        if program:
            experiment.cycle.turn = asking = Asking(experiment, scene.seed, program)

        def each(cycles: int) -> None:
            watch(cycles)
            asked()
            moments()
            faults(cycles)
            losses()

        try:
            run(experiment.cycle, max(1, round(scene.duration / loaded.bus.sample_time)), progress=each)
        except CanHapticError as error:
            status, text = "stopped", str(error)
        account = account_of(experiment.cycle, status)
        moments.judge(account)
        left = left_after(experiment, account)
        is_told = status == "completed" and not any(tag.startswith("fault:torque") for tag in scene.tags)
        after = claims_after(experiment, account, left) if is_told else []  # a broken drive goes on until it is off
        after += promises_broken_after(experiment, account)
        if status == "stopped":
            reaction, to_zero = experiment.rig.stop_reason.name, faults.syncs_to_zero()
    outcome = _outcome(scene, account, watch, asked, status, text)
    if not all(experiment.cycle.unbooked.values()):
        outcome = replace(outcome, tags=tuple(sorted({*outcome.tags, _UNCONFIRMED})))
    if program:
        outcome = replace(outcome, asked=asking.asked)
    outcome = replace(outcome, false_claims=(*outcome.false_claims, *moments.claims, *after))
    given_after = max(0.0, *(-energy for energy in left.values()))
    return replace(
        _with_losses(outcome, scene, losses), reaction=reaction, to_zero=to_zero, given_after=given_after
    ), watch


def _with_losses(outcome: Outcome, scene: TruthScene, losses: LossWatch) -> Outcome:
    declared = int(scene.passivity.get("max_consecutive_losses", 0))
    return replace(outcome, losses=losses.longest, declared_losses=declared, skipped=losses.skipped)


def _refused(scene: TruthScene, text: str) -> Outcome:
    empty: Any = {"verdict": "in doubt", "at_handle": "", "certificates": (), "resolution": 0.0, "error": 0.0}
    energies: Any = {"least": 0.0, "peak": 0.0, "asked": 0.0}
    return Outcome(
        scene.seed, tuple(sorted(scene.tags)), "refused", **empty, **energies, declared=True, false_claims=(), text=text
    )


class _Asked:
    """Largest torque that was sent, and largest effort that a wall asked for at the true position."""

    def __init__(self, experiment: Experiment) -> None:
        self._rig = experiment.rig
        self._plants = experiment.plants
        alone = [axis for axis in experiment.scene.axes if not axis.group]
        self._axes = [axis for axis in alone if axis.parameters.admittance is None]  # a display asks for no force
        self.peak = self.asked = 0.0

    def __call__(self) -> None:
        sent = self._rig.records[-1].torques_per_mille
        for drive, per_mille in zip(self._rig.drives, sent, strict=True):
            self.peak = max(self.peak, abs(drive.scaling.torque(per_mille)))
        for axis, plant in zip(self._axes, self._plants, strict=False):
            environment: Any = axis.environment.parameters
            if not environment.relaxes and environment.contact(plant.position):
                state = environment.true_state(plant.position, 0.0, 0.0)
                self.asked = max(self.asked, abs(environment.effort(state)))


class _Moments:
    """Holds what an account claims at every moment against what the plant did up to then.

    Where a second sender answers each SYNC too, the first answer is taken until the other is heard with the next SYNC:
    an error is then held against the resolution of that one.

    Once a true sum was below minus allowance and resolution, no later resolution makes a promise of it true again.
    """

    def __init__(self, experiment: Experiment, section: Mapping[str, Any], *, has_twin: bool = False) -> None:
        self._cycle, self._section, self._has_twin = experiment.cycle, section, has_twin
        ports = experiment.cycle.ports
        self._names = {port.row: port.name for port in ports}
        self._places = [port.row for port in ports]
        rows = len(experiment.cycle.ledgers)
        self._known = [0.0] * rows  # largest error that was judged before
        self._error, self._active = [0.0] * rows, [0] * rows
        self._below: set[tuple[int, str]] = set()
        self._cycles = 0
        self._said: dict[tuple[str, str], str] = {}  # port and kind -> the first false claim

    def __call__(self) -> None:
        judge, self._cycles = self._cycle.judge, self._cycles + 1
        if judge is None:
            return
        allowance, due = self._section.get("energy_allowance", 0.0), self._cycles % 50 == 0 and bool(self._below)
        for place in self._places:
            port, name = self._cycle.meters.ports[place], self._names[place]
            resolution = port.measured().energy_resolution
            most = resolution * (_ESTIMATE if port.activity.limits.floor == -inf else 1.0)
            found, self._error[place] = self._error[place], judge.believed_error[place]
            error, known = (found, self._known[place]) if self._has_twin else (self._error[place], found)
            if error > max(known, most + ROUNDING):
                self._claim(name, "error", f"error {error:.3g} J, resolution {resolution:.3g} J")
            self._known[place] = error
            sums = {"least_interaction": judge.least[place], "least_at_handle": judge.least_at_handle[place]}
            for key, least in sums.items():
                if least < -resolution - allowance - ROUNDING and (place, key) not in self._below:
                    self._below.add((place, key))
                    due = True
            for bit, least in zip((1, 2), sums.values(), strict=True):
                if port.activity.active & bit & ~self._active[place] and least >= -allowance - ROUNDING:
                    self._claim(name, "active", f"active, true least {least:.3g} J")
            self._active[place] = port.activity.active
        if due:
            self.judge(account_of(self._cycle, "running"))

    def judge(self, account: Mapping[str, Any]) -> None:
        """Takes an account, of a moment or of the end."""
        for place in self._places:
            name, port = self._names[place], account["ports"][self._names[place]]
            at_motor, at_handle = ((place, key) in self._below for key in ("least_interaction", "least_at_handle"))
            if at_motor and port["passive"] == "yes":
                self._claim(
                    name, "motor", f"passive yes, true least {account['truth'][name]['least_interaction']:.3g} J"
                )
            if at_handle and port.get("passive_at_handle") == "yes":
                self._claim(name, "handle", "passive at the handle yes")
            if self._active[place] & 1 and port["passive"] != "no":
                self._claim(name, "forgot", f"passive {port['passive']} after it was active")
            if (place, _promised(self._section)) in self._below and certificates(port):
                self._claim(name, "certificate", f"certificates {', '.join(certificates(port))}")

    def _claim(self, name: str, kind: str, text: str) -> None:
        self._said.setdefault((name, kind), f"{name}: {text} after {self._cycles} cycles")

    @property
    def claims(self) -> list[str]:
        """The first false claim of each kind."""
        return list(self._said.values())


def account_of(cycle: Cycle, status: str) -> RunResult:
    """Returns the account of a run so far.

    Args:
        cycle: The run.
        status: How it ended.
    """
    return run_result(cycle, status=status, config_hash="", method="")


def _outcome(
    scene: TruthScene, account: Mapping[str, Any], watch: HandWatch, asked: _Asked, status: str, text: str
) -> Outcome:
    ports = {name: port for name, port in account["ports"].items() if "passive" in port}
    section = scene.passivity
    hand = _of_hand(watch)
    within = all(section.get(key) is None or seen <= section[key] for key, seen in hand.items())
    found = {axis.get("hold") for axis in account["ports"].values()}
    is_unchecked, noted = NOT_CHECKED in found, {NOT_CHECKED: _UNCHECKED, UNDECIDED: _UNDECIDED}
    declared = scene.is_true and (within or not scene.promises) and not (is_unchecked and "hold:other" in scene.tags)
    claims = [
        claim for name, port in ports.items() for claim in _false_claims(name, port, account["truth"][name], section)
    ]
    worst = max(
        ports, key=lambda name: account["truth"][name]["accounted_error"] / (_resolution(ports[name]) + ROUNDING)
    )
    handles = [port["passive_at_handle"] for port in ports.values() if "passive_at_handle" in port]
    return Outcome(
        seed=scene.seed,
        tags=tuple(sorted({*scene.tags, *(noted[hold] for hold in found if hold in noted)})),
        status=status,
        verdict=str(account["passive"]),
        at_handle=max(handles, key=("yes", "in doubt", "no").index) if handles else "",
        certificates=tuple(sorted({name for port in ports.values() for name in certificates(port)})),
        resolution=_resolution(ports[worst]),
        error=account["truth"][worst]["accounted_error"],
        least=min(account["truth"][name]["least_interaction"] for name in ports),
        peak=asked.peak,
        asked=asked.asked,
        declared=declared,
        false_claims=tuple(claims),
        text=text,
        open_share=max(_resolution(port) / (port["in"] + ROUNDING) for port in ports.values()),
        lost=max(_lost(port, account["truth"][name], section) for name, port in ports.items()),
    )


def _lost(port: Mapping[str, Any], truth: Mapping[str, float], section: Mapping[str, Any]) -> float:
    least = truth[_promised(section)]
    return float(-least - section.get("energy_allowance", 0.0) - _resolution(port))


def _promised(section: Mapping[str, Any]) -> str:
    """Returns the sum of which certificates promise that it does not fall below zero."""
    is_braked = section.get("device_damping") or section.get("device_friction")
    return "least_at_handle" if is_braked else "least_interaction"


def _resolution(port: Mapping[str, Any]) -> float:
    value = port.get("energy_resolution", 0.0)
    return float("inf") if value is None else float(value)


def certificates(port: Mapping[str, Any]) -> list[str]:
    """Returns the names of the certificates that an account names; "exact" where none had to bound a torque."""
    return [name for name in port["certificates"] if name != "none"]


def _false_claims(
    name: str, port: Mapping[str, Any], truth: Mapping[str, float], section: Mapping[str, Any]
) -> list[str]:
    resolution, least, error = _resolution(port), truth["least_interaction"], truth["accounted_error"]
    allowance = section.get("energy_allowance", 0.0)
    claims = []
    if error > resolution * (_ESTIMATE if port.get("resolution_is_estimated") else 1.0) + ROUNDING:
        claims.append(f"{name}: error {error:.3g} J, resolution {resolution:.3g} J")
    verdicts = {port["passive"], port.get("passive_at_handle", "in doubt")}
    if port.get("resolution_is_estimated") and verdicts != {"in doubt"}:
        claims.append(f"{name}: a verdict by a resolution that is an estimate")
    if port["passive"] == "yes" and least < -resolution - allowance - ROUNDING:
        claims.append(f"{name}: passive yes, true least {least:.3g} J, resolution {resolution:.3g} J")
    if port["passive"] == "no" and least >= -allowance - ROUNDING:
        claims.append(f"{name}: passive no, true least {least:.3g} J")
    if port.get("passive_at_handle") == "yes" and truth["least_at_handle"] < -resolution - allowance - ROUNDING:
        claims.append(f"{name}: passive at the handle yes, true least {truth['least_at_handle']:.3g} J")
    if port.get("passive_at_handle") == "no" and truth["least_at_handle"] >= -allowance - ROUNDING:
        claims.append(f"{name}: passive at the handle no, true least {truth['least_at_handle']:.3g} J")
    # with declared damping or friction the promise is that of the handle, whichever certificate is the weakest of a run
    below = truth[_promised(section)]
    for certificate in certificates(port):
        if certificate != "exact" and section.get(_DECLARED_BY.get(certificate, certificate)) is None:
            claims.append(f"{name}: certificate {certificate}, which is not declared")
        if below < -resolution - allowance - ROUNDING:
            claims.append(f"{name}: certificate {certificate}, true least {below:.3g} J")
    return claims

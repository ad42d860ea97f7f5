"""`canhaptic check CONFIG`: whether a scene can run, what limits it, and the real-time settings of this computer."""

import argparse
import os
import platform
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

import yaml
from rich.console import Console
from rich.markup import escape
from rich.text import Text

from canhaptic.axis_units import counted, si, stiffness_unit
from canhaptic.cli.check_eds import WORDS
from canhaptic.cli.long_command import unguarded
from canhaptic.cli.options import scene_of
from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.drive.can.bus_budget import BusBudget, require_budget
from canhaptic.drive.can.pdo_map import choose_map
from canhaptic.drive.profile.fitness import Finding, Verdict
from canhaptic.drive.survey import Suitability, survey
from canhaptic.host.realtime import GRANTED, Realtime
from canhaptic.quantities import with_old_names
from canhaptic.scene import hints as limits
from canhaptic.scene.build import build, require_buildable
from canhaptic.scene.buses import kind_of
from canhaptic.scene.cross_checks import findings_on
from canhaptic.scene.first_contact import (
    FELT,
    advice,
    felt_stiffness,
    halves_rendered,
    kept_through_losses,
    slowest_felt,
)
from canhaptic.scene.hints import guarantee
from canhaptic.scene.method import dear_holds
from canhaptic.scene.models import AxisScene, Guess, Scene, refused_values, status_text, values_to_set
from canhaptic.view.run_lines import make_console
from canhaptic.view.table import Cell, Styled, Table
from canhaptic.view.terminal import write_json

if TYPE_CHECKING:
    from canhaptic.scene.far_findings import LinkFigure


class _HostSetting(NamedTuple):
    """One setting of this computer."""

    name: str
    value: str
    advice: str  # what to do about it; empty when nothing


_PROCESS: Final = 64 << 20  # of memory that the program has at least [B]


def host_settings() -> list[_HostSetting]:
    """Settings of this computer that affect the timing of a cycle; unreadable ones are left out."""
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    is_realtime, runtime = _read("/sys/kernel/realtime") == "1", _read("/proc/sys/kernel/sched_rt_runtime_us")
    governor = _read("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
    source = _read("/sys/devices/system/clocksource/clocksource0/current_clocksource")
    late = "no PREEMPT_RT: wake-ups may be late by milliseconds"
    alone = "the log writer shares the only processor with the cycle"
    slow = "cpupower frequency-set -g performance keeps the clock up"
    settings = [
        ("kernel", f"{platform.system()} {platform.release()}", "" if is_realtime else late),
        ("processors", str(processors), "" if processors > 1 else alone),
        _limit("real-time priority", "RLIMIT_RTPRIO", "rtprio"),
        _limit("locked memory", "RLIMIT_MEMLOCK", "memlock"),
        ("real-time share", "all" if runtime == "-1" else runtime and f"{runtime} us of each second", ""),
        ("frequency governor", governor, "" if governor == "performance" else slow),
        ("clock source", source, "too coarse for a cycle" if source == "jiffies" else ""),
    ]
    return [_HostSetting(*setting) for setting in settings if setting[1]]


def _limit(name: str, key: str, item: str) -> tuple[str, str, str]:
    try:
        import resource

        soft, _ = resource.getrlimit(getattr(resource, key))  # Linux alone has both
    except (ImportError, AttributeError):  # the first on Windows
        return name, "not on this system", ""
    advice = "" if soft else f"not permitted; grant `{item}` in /etc/security/limits.conf"
    granted = "unlimited" if soft == resource.RLIM_INFINITY else _memory(soft) if item == "memlock" else str(soft)
    return name, granted, advice


def _memory(size: int) -> str:
    return f"{size >> 20} MiB" + ("" if size >= _PROCESS else ": too little for lock_memory, unless you are root")


def _read(path: str) -> str:
    try:
        return Path(path).read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        return ""


NO_WALL: Final = "NO WALL for this rig and hand"
_TO_BE_SET: Final = 1  # exit status: a run is refused until the marked values are set


def execute(arguments: argparse.Namespace) -> int:
    """Print the verdict, the bus load, the fitness of each drive, the stability limits and the host settings.

    Returns 1 if a run would be refused because values of a real drive are still to be set, else 0.
    """
    found = _findings_of(scene_of(arguments), asks_drives=arguments.bus)
    if arguments.json:
        write_json(_as_json(found))
    else:
        _print(make_console(), found, resolved=arguments.resolved, full=arguments.full)
    return _TO_BE_SET if found.refused else 0


def checked(scene: Scene) -> dict[str, Any]:
    """Return the findings on a scene as `check --json` prints them."""
    return _as_json(_findings_of(scene))


def _findings_of(scene: Scene, *, asks_drives: bool = False) -> "_CheckFindings":
    axes = [axis.parameters for axis in scene.axes]
    dictionaries = [axis.dictionary() for axis in axes]
    on_can = {name: bus for name, bus in scene.buses if isinstance(bus, CanBusParameters)}
    of_axes = zip(dictionaries, scene.axes, strict=True)
    maps = [(of.bus, choose_map(d, of.parameters)) for d, of in of_axes if of.bus in on_can]
    if not scene.unread:
        require_buildable(scene)
    tried = ((axis.parameters.name, slowest_felt(axis)) for axis in scene.axes)
    kept: dict[str, list[Finding]] = {}
    if asks_drives:  # their limits, ramps and reactions
        with build(scene) as experiment:
            kept = {axis.name: experiment.rig.read_objects(n) for n, axis in enumerate(axes)}
    return _CheckFindings(
        scene=scene,
        budgets={name: require_budget(bus, [plan for on, plan in maps if on == name]) for name, bus in on_can.items()},
        findings={
            axis.parameters.name: findings_on(dictionary, axis.parameters, scene.bus_of(axis))
            for dictionary, axis in zip(dictionaries, scene.axes, strict=True)
        },
        hints=limits.hints_of(scene),
        felt={name: speed for name, speed in tried if speed is not None},
        fitness=[_fitness(*of, scene) for of in zip(dictionaries, scene.axes, strict=True)],
        dear=dear_holds(scene) if scene.simulated and not scene.unread else [],
        objects=kept,
        far=_far_findings(scene) if scene.far is not None else [],
    )


def _far_findings(scene: Scene) -> "list[LinkFigure]":
    from canhaptic.scene.far_findings import far_findings

    return far_findings(scene)


_USUAL: Final = 0.01
"""Speed at which the two flanks of a detent are judged, as a fraction of the axis's largest speed."""


def _felt(axis: AxisScene) -> float | None:
    """Return the stiffness that a leaning hand feels [N/m or N*m/rad]; None where the wall is no spring."""
    found = felt_stiffness(axis)
    return None if found is None else found[0]


def _leant(axis: AxisScene) -> str:
    """Return in words which stiffness a leaning hand feels; "" where the wall is no spring."""
    found, unit = felt_stiffness(axis), stiffness_unit(axis.parameters.unit)
    return f"; leaned on, it is felt as {si(found[0], unit, 3)} of {si(found[1], unit, 3)}" if found else ""


class _CheckFindings(NamedTuple):
    """Findings of `check`."""

    scene: Scene
    budgets: dict[str, BusBudget]
    findings: dict[str, list[Finding]]
    hints: list[limits.Hint]
    felt: dict[str, float]  # axis -> approach speed from which its wall is felt [m/s or rad/s], infinite: from none
    fitness: list[str]  # of each drive, in the words of `check-eds`
    dear: list[str]  # simulated plants whose sample time may take long
    objects: dict[str, list[Finding]]  # of each axis, as its drive has them; empty where none was asked
    far: "list[LinkFigure]"  # of the link to a far side; empty without one

    def wall(self) -> str:
        """Sentence: from which approach speed the weakest wall is felt, or why none is; "" if no wall can be tried."""
        if not self.felt:
            return ""
        name = max(self.felt, key=self.felt.__getitem__)
        axis, at = self.scene.axis(name), "" if len(self.scene.axes) == 1 else f" at {name}"
        if self.felt[name] == inf:
            return f"{NO_WALL}{at}: {advice(axis)}"
        speed, unit = _USUAL * axis.parameters.largest_speed, f"{axis.parameters.unit}/s"
        halves = halves_rendered(axis, speed)
        shares = "{:.0%} of the force is rendered up to a crest and {:.0%} beyond it"
        both = f" (at {speed:.2g} {unit}, {shares.format(*halves)})" if halves else ""
        allowance = getattr(axis.passivity.parameters, "energy_allowance", 0.0)
        if halves and allowance and (spent := halves_rendered(axis, speed, is_spent=True)):
            left = f"while any of the energy_allowance of {si(allowance, 'J', 3)} is left, {shares.format(*halves)}"
            both = f" (at {speed:.2g} {unit}: {left}; once it is spent, {spent[0]:.0%} and {spent[1]:.0%})"
        lost = self._under_losses(axis, max(speed, self.felt[name]))
        felt = f"is felt (half of its force or more) at approach speeds above {self.felt[name]:.2g} {unit}"
        what = "notch" if axis.environment.name == "detents" else "wall"
        return f"the {what}{at} {felt}{both}{lost}{_leant(axis)}"

    def _under_losses(self, axis: AxisScene, speed: float) -> str:
        """Return in words how much force of a pressed wall remains if frames are lost; "" if no losses are declared."""
        if not getattr(axis.passivity.parameters, "max_consecutive_losses", 0):
            return ""
        tried = kept_through_losses(axis, speed)
        kept = max((lost for lost, share in tried if share >= FELT), default=0.0)
        shares = [(f"at least {FELT:.0%}", f"up to {kept:.1%}")] if kept else []
        shares += [(f"{share:.0%}", f"{lost:.1%}") for lost, share in tried if lost > kept][:1]
        parts = ", ".join(f"{share} of its force if {lost} of the frames are lost" for share, lost in shares)
        return f"; pressed for 1 s, it keeps {parts}"

    @property
    def refused(self) -> bool:
        """Whether a run would be refused because values are still guesses."""
        return bool(refused_values(self.scene))

    @property
    def exceeded(self) -> list[limits.Hint]:
        """Limits that the scene exceeds and the guarantee of its algorithm depends on."""
        return [hint for hint in self.hints if hint.exceeded and hint.concerns]

    def verdict(self) -> str:
        """One line: whether the scene can run, its wall, the fitness of the drives, bus load and exceeded limits."""
        over = ", ".join(dict.fromkeys(hint.what for hint in self.exceeded))
        load, fitness = [budget.periodic_load for budget in self.budgets.values()], Counter(self.fitness).items()
        parts = [
            "" if inf in self.felt.values() else self.wall(),
            *(f"{counted(count, 'drive')} {'is' if count == 1 else 'are'} {word}" for word, count in fitness),
            f"bus load {100.0 * max(load):.0f} %" if load else "",
            f"{', '.join(self.scene.unread)} not run, so its parameters are not checked" if self.scene.unread else "",
            f"{counted(len(self.exceeded), 'limit')} exceeded: {over}" if over else "",
        ]
        return f"{status_text(self.scene)}; {', '.join(part for part in parts if part)}"


def _fitness(dictionary: Any, axis: AxisScene, scene: Scene) -> str:
    """Return whether the drive of an axis is usable, in the words of `check-eds`."""
    bus = scene.bus_of(axis)
    if kind_of(bus) == "can":
        return str(survey(dictionary, axis.parameters).suitability.value)
    is_fit = all(row.verdict is Verdict.FIT for row in findings_on(dictionary, axis.parameters, bus))
    return str((Suitability.FIT if is_fit else Suitability.CONDITIONAL).value)


def _as_json(found: _CheckFindings) -> dict[str, Any]:
    scene, budgets, findings, hints, felt, fitness, _, objects, far = found
    buses = {name: _budget_as_json(budget) for name, budget in budgets.items()}
    return {
        "status": "ok",
        "ready": not found.refused,
        "verdict": found.verdict(),
        "wall": found.wall(),
        "dear": found.dear,
        "unguarded": [*unguarded(scene)],
        "fitness": fitness,
        "guarantee": {axis.parameters.name: guarantee(axis, hints) for axis in scene.axes},
        "felt_from": felt,  # infinite: null
        "felt_stiffness": {name: _felt(scene.axis(name)) for name, speed in felt.items() if speed < inf},
        "config_hash": None if scene.unread else scene.config_hash(),  # it holds the defaults of own code
        "unread": list(scene.unread),
        "to_set": [guess._asdict() for guess in values_to_set(scene)],
        "config": scene.resolved(),
        **({"buses": buses} if scene.bus_name else {"bus": buses.get("")}),
        "drives": _findings_as_json(findings),
        **({"objects": _findings_as_json(objects)} if objects else {}),
        "stability": [with_old_names({**hint._asdict(), "exceeded": hint.exceeded}) for hint in hints],
        **({"far": [figure._asdict() for figure in far]} if far else {}),
        "host": [setting._asdict() for setting in host_settings()],
        "realtime": _realtime(scene),
    }


def _findings_as_json(findings: dict[str, list[Finding]]) -> dict[str, list[dict[str, str]]]:
    return {
        name: [{"item": f.item, "verdict": f.verdict.value, "text": f.text} for f in rows]
        for name, rows in findings.items()
    }


def _budget_as_json(budget: BusBudget) -> dict[str, Any]:
    return {
        "rows": [{**row._asdict(), "bits": row.bits} for row in budget.rows],
        "worst_cycle": budget.worst_cycle,
        "sample_time": budget.sample_time,
        "periodic_load": budget.periodic_load,
        "arithmetic": budget.arithmetic(),
    }


def _print(console: Console, found: _CheckFindings, *, resolved: bool, full: bool) -> None:
    scene = found.scene
    for text in unguarded(scene):
        console.print(f"[bold red]{escape(text)}[/]")
    if inf in found.felt.values():
        console.print(f"[bold red]{escape(found.wall())}[/]")
    colour = "red" if found.refused else "yellow" if found.exceeded else "green"
    console.print(f"[bold {colour}]{escape(found.verdict())}[/]")
    where = "; ".join(f"{bus.parameters.interface} {bus.parameters.channel or ''}".strip() for bus in scene.buses)
    name = "scene" if scene.unread else f"scene (checksum {scene.config_hash()[:12]})"
    line = f"{name} on {where} at {1.0 / scene.bus.sample_time:g} Hz"
    console.print(line + ("" if resolved else "; every value: --resolved"), markup=False)
    for text in found.dear:
        console.print(f"[yellow]{escape(text)}[/]")
    said = [(axis.parameters.name, guarantee(axis, found.hints)) for axis in scene.axes]
    for text, names in _axes_of(((name, text) for name, text in said if text), len(said)).items():
        console.print(f"{names}: {text}", markup=False)
    unset = values_to_set(scene)
    if found.refused or any(guess.line for guess in unset):
        console.print("set these before connecting a drive:")
        console.print(_guesses(unset, full=full))
    if resolved:
        values = _without_empty(scene.resolved())
        console.print(yaml.safe_dump(values, sort_keys=False, allow_unicode=True), markup=False)
    _print_findings(console, found, full=full)
    if answers := _realtime(scene):
        styles = ["" if answer == GRANTED else "yellow" for answer in answers.values()]
        rows = [[Styled(text, style) for text in pair] for pair, style in zip(answers.items(), styles, strict=True)]
        console.print(Table("bus.realtime", ("setting", "answer of the system"), rows))


def _print_findings(console: Console, found: _CheckFindings, *, full: bool) -> None:
    """Print bus load, drives, limits and host settings; unless `full`, only problems and key figures."""
    for name, budget in found.budgets.items():
        bus, used, most = f"bus {name}".rstrip(), 1e6 * budget.worst_cycle, 1e6 * budget.sample_time
        if full:
            console.print(_bus_table(bus, budget))
            console.print(f"  worst cycle: {budget.arithmetic()}", markup=False, soft_wrap=True)
            console.print(f"  periodic load of the bus: {100.0 * budget.periodic_load:.1f} %\n")
        else:
            worst = f"worst cycle {used:.0f} of {most:.0f} us, with heartbeats, one EMCY and computing time"
            console.print(f"{bus}: {worst}; {100.0 * budget.periodic_load:.0f} % load on average", markup=False)
    for axis in found.scene.axes:
        name = axis.parameters.name
        if rows := [row for row in found.findings[name] if full or row.verdict is not Verdict.FIT]:
            console.print(_fitness_table(f"{name}: {axis.parameters.dictionary_path}", rows))
        if found.objects:
            console.print(_fitness_table(f"{name}: kept in the drive", found.objects[name]))
    console.print(_hint_table([h for h in found.hints if full or h.concerns], len(found.scene.axes), texts=full))
    if found.far:
        console.print(_far_table(found.far))
    settings = [setting for setting in host_settings() if full or setting.advice]
    if full:
        console.print(Table("host", ("setting", "value", "advice"), settings))
        return
    if settings:
        console.print("host: " + "; ".join(f"{setting.name}: {setting.advice}" for setting in settings), markup=False)
    console.print("[dim]every object, limit and setting: --full[/]")


def _guesses(unset: list[Guess], *, full: bool) -> Table | Text:
    """Values to set: names and line numbers, or if `full` a table with explanations."""
    if full:
        rows = [(guess.line or "", guess.key, guess.value, guess.note) for guess in unset]
        return Table("to set", ("line", "key", "guess", "what belongs there"), rows)
    given = (f"{guess.key}: {guess.value} (line {guess.line})" for guess in unset if guess.line)
    values = [*given, *(f"{guess.key} (missing)" for guess in unset if not guess.line)]
    return Text("  " + ", ".join(values))


def _realtime(scene: Scene) -> dict[str, str]:
    """Request the settings of `bus.realtime`, release them, and return the operating system's answers."""
    realtime = Realtime(scene.bus.realtime)
    realtime.begin()
    realtime.end()
    return realtime.report


def _without_empty(values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: _without_empty(entry) if isinstance(entry, Mapping) else entry
        for key, entry in values.items()
        if entry not in (None, {}, [])
    }


def _bus_table(bus: str, budget: BusBudget) -> Table:
    rows = [
        (row.kind, row.frames, row.bits_each, row.bits, f"{row.bits / budget.bitrate * 1e6:.0f} us")
        for row in budget.rows
    ]
    return Table(f"{bus}, worst cycle", ("what", "frames", "bits each", "bits", "time"), rows)


def _far_table(figures: "list[LinkFigure]") -> Table:
    rows = [(of.what, "not known" if of.value is None else si(of.value, of.unit, 3), of.text) for of in figures]
    return Table("link to the far side, before it runs", ("what", "value", "on what it rests"), rows)


def _fitness_table(title: str, findings: list[Finding]) -> Table:
    return Table(title, ("object", "verdict", ""), [[row.item, WORDS[row.verdict], row.text] for row in findings])


_Said = TypeVar("_Said", bound=Hashable)
_FEW: Final = 2  # axes, which are named one by one


def _axes_of(said: Iterable[tuple[str, _Said]], axes: int) -> dict[_Said, str]:
    """Return every remark once, with the names of its axes: "every axis" where it is on all of more than two."""
    found: dict[_Said, list[str]] = {}
    for name, of in said:
        found.setdefault(of, []).append(name)
    return {of: "every axis" if _FEW < len(names) == axes else ", ".join(names) for of, names in found.items()}


def _hint_table(hints: list[limits.Hint], axes: int, *, texts: bool) -> Table:
    rows: list[list[Cell]] = []
    for hint, names in _axes_of(((hint.axis, hint._replace(axis="")) for hint in hints), axes).items():
        unknown = "device_friction not set" if hint.is_of_encoder else "unknown"
        unit = "" if hint.unit == "1" else f" {hint.unit}"
        limit = unknown if hint.limit is None else f"{hint.limit:.4g}{unit}"
        over = "" if not hint.exceeded else " EXCEEDED" if hint.concerns else " exceeded"
        requested = "" if hint.requested is None else f"{hint.requested:.4g}{over}"
        style = "dim" if not hint.concerns else "yellow" if hint.exceeded else ""
        rows.append([Styled(text, style) for text in (names, hint.what, limit, requested, hint.text)[: 4 + texts]])
    title = "stability limits, calculated for any hand within your declarations; `design` simulates this rig"
    return Table(title, ("axis", "limit", "value", "requested", "")[: 4 + texts], rows)

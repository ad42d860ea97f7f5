"""Check of SocketCAN interfaces before a run: the kernel's report, compared with the scene.

The kernel is asked through `ip -details -statistics -json link show`. A fault refuses the run; an unwise or unknown
setting is a note.

Bus-off (the controller gave up after too many errors) ends a run, and nothing may restart it unnoticed. With
`restart-ms 0` the controller stays off until a person restarts it. With a restart after the rig has certainly stopped
(`stop_cycles` sample times) the bus comes back to drives that are disabled. A restart before that would let a run
continue unnoticed, and is refused.
"""

import json
import math
import subprocess
from collections.abc import Callable, Mapping
from typing import Any, Final, Literal, NamedTuple

from canhaptic.errors import LinkError
from canhaptic.host.interfaces import BusSettings, RigSettings

_Severity = Literal["well", "note", "refused"]
Runner = Callable[[list[str]], "subprocess.CompletedProcess[str]"]

_TIMEOUT: Final = 5.0  # [s] for `ip`
_ALARMING_ERRORS: Final = 96  # the error counter from which a controller warns (ISO 11898-1)
_FRAMES_BESIDE_RPDOS: Final = 3  # SYNC, heartbeat, SDO
_REAL_CONTROLLERS: Final = "can"  # info_kind of an interface with a controller; vcan and vxcan have none
_VIRTUAL_KINDS: Final = ("vcan", "vxcan")


class PreflightFinding(NamedTuple):
    """One property of an interface, judged."""

    interface: str  # channel, as can0
    item: str
    seen: str
    severity: _Severity
    text: str  # expected value and remedy; empty when all is well


def preflight(scene: RigSettings, run: Runner | None = None) -> list[PreflightFinding]:
    """The kernel's report on every SocketCAN interface of a scene; none for other interfaces.

    Args:
        scene: Scene that names the interfaces.
        run: Runs a command and returns what it printed; `ip` itself by default.
    """
    findings = []
    for bus in scene.buses:
        if bus.parameters.interface == "socketcan":
            axes = sum(axis.bus == bus.name for axis in scene.axes)
            findings += _inspect_interface(str(bus.parameters.channel), bus.parameters, axes, run or _run)
    return findings


def all_links_are_virtual(scene: RigSettings, run: Runner | None = None) -> bool:
    """Whether no bus of a scene can have a real drive, according to the kernel.

    That is so for the virtual bus of this process and for SocketCAN interfaces of the kinds vcan and vxcan. The name of
    an interface is not considered. An interface unknown to the kernel counts as real.

    Args:
        scene: Scene that names the interfaces.
        run: Runs a command and returns what it printed; `ip` itself by default.
    """
    return all(_is_virtual(bus.parameters, run or _run) for bus in scene.buses)


def _is_virtual(bus: BusSettings, run: Runner) -> bool:
    if bus.interface != "socketcan":
        return bus.interface == "virtual"
    try:
        [link] = json.loads(run(_question(str(bus.channel))).stdout)
        return link["linkinfo"]["info_kind"] in _VIRTUAL_KINDS
    except (OSError, subprocess.SubprocessError, ValueError, KeyError, TypeError):
        return False


def _question(channel: str) -> list[str]:
    return ["ip", "-details", "-statistics", "-json", "link", "show", "dev", channel]


def require_preflight(scene: RigSettings, run: Runner | None = None) -> list[PreflightFinding]:
    """Return the notes of a preflight; raise where one forbids a run.

    Raises:
        LinkError: There is such a reason; lists every one.
    """
    findings = preflight(scene, run)
    refused = [f for f in findings if f.severity == "refused"]
    if refused:
        raise LinkError("; ".join(f"{f.interface}: {f.item}: got {f.seen}, {f.text}" for f in refused))
    return [f for f in findings if f.severity == "note"]


def _inspect_interface(channel: str, bus: BusSettings, axes: int, run: Runner) -> list[PreflightFinding]:
    """The kernel's report on one interface.

    Args:
        channel: Name of the interface.
        bus: Settings of the bus.
        axes: Drives on it.
        run: Runs a command and returns what it printed.
    """
    try:
        done = run(_question(channel))
    except (OSError, subprocess.SubprocessError) as error:
        text = f"cannot be checked ({error}); install iproute2 so that a wrong bit rate is found before a run"
        return [PreflightFinding(channel, "ip", "no answer", "note", text)]
    if done.returncode and "does not exist" in done.stderr:
        text = "expected an interface of this name; plug the adapter in and load its module, see `ip link`"
        return [PreflightFinding(channel, "interface", "none", "refused", text)]
    try:
        [link] = json.loads(done.stdout)
        return _judge_link(channel, link, bus, axes)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        seen = " ".join((done.stderr or done.stdout or repr(error)).split())[:80]
        text = "cannot be checked; this `ip` prints no JSON (busybox's does not), install iproute2"
        return [PreflightFinding(channel, "ip", seen, "note", text)]


def _judge_link(channel: str, link: Mapping[str, Any], bus: BusSettings, axes: int) -> list[PreflightFinding]:
    """Findings about an interface from its entry of `ip -json`."""
    judged = _Judged(channel)
    if link.get("link_type") != "can":
        judged.refuse("link type", link.get("link_type"), "expected can; name a CAN interface in bus.channel")
        return judged.findings
    info = link.get("linkinfo") or {}
    if "UP" not in link.get("flags", []):
        command = f"ip link set {channel} up type can bitrate {bus.bitrate}"
        judged.refuse("link", "down", f"expected up; {command}")
    else:
        judged.well("link", "up")
    _judge_queue(link, axes, judged)
    if info.get("info_kind") == _REAL_CONTROLLERS:
        _judge_controller(info.get("info_data") or {}, info.get("info_xstats") or {}, bus, judged)
    else:
        judged.well("controller", f"none ({info.get('info_kind')})")
    return judged.findings


class _Judged:
    """Collects the findings about one interface."""

    def __init__(self, channel: str) -> None:
        self.channel = channel
        self.findings: list[PreflightFinding] = []

    def well(self, item: str, seen: object, text: str = "") -> None:
        """Add a property that is correct."""
        self._add(item, seen, "well", text)

    def note(self, item: str, seen: object, text: str) -> None:
        """Add a property that is unwise or unknown."""
        self._add(item, seen, "note", text)

    def refuse(self, item: str, seen: object, text: str) -> None:
        """Add one that forbids a run."""
        self._add(item, seen, "refused", text)

    def _add(self, item: str, seen: object, severity: _Severity, text: str) -> None:
        self.findings.append(PreflightFinding(self.channel, item, str(seen), severity, text))


def _judge_queue(link: Mapping[str, object], axes: int, judged: _Judged) -> None:
    """Judge the transmit queue: one that is shorter than two cycles refuses frames (ENOBUFS) at the first delay."""
    length, needed = link.get("txqlen"), 2 * (axes + _FRAMES_BESIDE_RPDOS)
    if not isinstance(length, int):
        return
    if length < needed:
        command = f"ip link set {judged.channel} txqueuelen {4 * needed}"
        text = f"expected at least {needed} (two cycles of {axes} axes); {command}"
        judged.note("txqueuelen", length, text)
    else:
        judged.well("txqueuelen", length)


def _judge_controller(
    data: Mapping[str, Any], statistics: Mapping[str, int], bus: BusSettings, judged: _Judged
) -> None:
    bitrate = (data.get("bittiming") or {}).get("bitrate", data.get("bittiming_bitrate"))
    if bitrate is None:
        judged.note("bit rate", "not reported", f"cannot be compared with bus.bitrate {bus.bitrate}")
    elif bitrate != bus.bitrate:
        name = judged.channel
        command = f"ip link set {name} down; ip link set {name} up type can bitrate {bus.bitrate}"
        judged.refuse("bit rate", bitrate, f"expected {bus.bitrate} as bus.bitrate says; correct it, or: {command}")
    else:
        judged.well("bit rate", bitrate)
    _judge_state(str(data.get("state", "not reported")), judged)
    _judge_modes(data.get("ctrlmode") or [], judged)
    _judge_restart(data.get("restart_ms"), bus, judged)
    _judge_errors(data.get("berr_counter") or {}, statistics, judged)


def _judge_state(state: str, judged: _Judged) -> None:
    if state == "BUS-OFF":
        text = (
            "expected ERROR-ACTIVE; find the cause (cable, termination, a node with another bit rate), then: "
            f"ip link set {judged.channel} type can restart"
        )
        judged.refuse("state", state, text)
    elif state in ("STOPPED", "SLEEPING"):
        judged.refuse("state", state, f"expected ERROR-ACTIVE; ip link set {judged.channel} up")
    elif state == "ERROR-ACTIVE":
        judged.well("state", state)
    else:
        judged.note("state", state, "expected ERROR-ACTIVE; no node acknowledges, or cable and termination are bad")


def _judge_modes(modes: list[str], judged: _Judged) -> None:
    for mode, name in (("LISTEN-ONLY", "listen-only"), ("LOOPBACK", "loopback"), ("ONE-SHOT", "one-shot")):
        if mode in modes:
            link = f"ip link set {judged.channel}"
            text = f"expected an ordinary controller; {link} down; {link} up type can {name} off"
            judged.refuse("mode", mode, text)


def _least_restart(bus: BusSettings) -> int:
    """Return the shortest automatic restart after a bus-off [ms] that finds the rig stopped."""
    return math.ceil(bus.stop_cycles * bus.sample_time * 1e3)


def _judge_restart(restart: object, bus: BusSettings, judged: _Judged) -> None:
    if not isinstance(restart, int):
        judged.note("restart-ms", "not reported", "cannot be checked; set `restart-ms 0`")
        return
    if restart == 0:
        judged.well("restart-ms", "0 (by hand)")
    elif restart < _least_restart(bus):
        text = (
            f"expected 0, or at least {_least_restart(bus)} ms ({bus.stop_cycles} sample times, after which the rig "
            "has stopped), so that a bus-off ends the run and does not go unseen; "
            f"ip link set {judged.channel} type can restart-ms 0"
        )
        judged.refuse("restart-ms", f"{restart} ms", text)
    else:
        judged.well("restart-ms", f"{restart} ms", "after a bus-off the interface recovers, the run does not")


def _judge_errors(counters: Mapping[str, int], statistics: Mapping[str, int], judged: _Judged) -> None:
    worst = max((int(counters.get(side, 0)) for side in ("tx", "rx")), default=0)
    seen = f"tx {counters.get('tx', '?')}, rx {counters.get('rx', '?')}"
    if worst >= _ALARMING_ERRORS:
        judged.note("error counters", seen, f"expected below {_ALARMING_ERRORS}; check cable, termination, bit rate")
    else:
        judged.well("error counters", seen)
    offs = statistics.get("bus_off", 0)
    if offs:
        judged.note("bus-offs so far", offs, "expected none since the interface came up; find the cause")


def _run(command: list[str]) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT, check=False)

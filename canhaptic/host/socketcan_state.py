"""Preflight of the interfaces of a scene: of SocketCAN, `ip -details -statistics -json link show` against the scene.

A fault refuses the run; an unwise or unknown setting is a note.

A bus-off (the controller gave up after too many errors) must end a run. With `restart-ms 0` the controller stays off
until a person restarts it. A longer `restart-ms` is safe if the rig has certainly stopped by then (`stop_cycles`
sample times): the bus comes back to disabled drives. A shorter one is refused, since a run would continue unnoticed.
"""

import json
import math
import subprocess
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, Final

from canhaptic.errors import LinkError
from canhaptic.host.findings import PreflightFinding, Row, row
from canhaptic.host.interfaces import BusSettings, LineSettings, is_line

Runner = Callable[[list[str]], "subprocess.CompletedProcess[str]"]

_ALARMING_ERRORS: Final = 96  # the error counter from which a controller warns (ISO 11898-1)


def preflight(
    buses: Iterable[tuple[BusSettings | LineSettings, int]], run: Runner | None = None
) -> list[PreflightFinding]:
    """Judge every SocketCAN interface of a scene, and that of an EtherCAT line; others have no findings.

    Args:
        buses: Buses of the scene, and the number of drives on each.
        run: Function that runs a command and returns its output; a subprocess by default.
    """
    findings = list[PreflightFinding]()
    for bus, axes in buses:
        if not is_line(bus):
            is_judged = bus.interface == "socketcan"
            findings += _inspect_interface(str(bus.channel), bus, axes, run or _run) if is_judged else ()
        elif bus.interface != "virtual":
            from canhaptic.host.ethernet_state import inspect_interface

            findings += inspect_interface(bus.interface)
    return findings


def all_links_are_virtual(buses: Iterable[tuple[BusSettings | LineSettings, int]], run: Runner | None = None) -> bool:
    """Return whether no bus of a scene can have a real drive.

    Virtual are the bus within this process, and interfaces that the kernel reports as vcan, vxcan or, for EtherCAT, as
    a veth that no bridge owns. The name of an interface does not matter, and one unknown to the kernel counts as real.

    Args:
        buses: Buses of the scene, and the number of drives on each.
        run: Function that runs a command and returns its output; a subprocess by default.
    """
    return all(_is_virtual(bus, run or _run) for bus, _ in buses)


def _is_virtual(bus: BusSettings | LineSettings, run: Runner) -> bool:
    if bus.interface == "virtual":
        return True
    try:
        if is_line(bus):
            [link] = json.loads(run(_question(bus.interface)).stdout)
            return link["linkinfo"]["info_kind"] == "veth" and "master" not in link
        if bus.interface != "socketcan":
            return False
        [link] = json.loads(run(_question(str(bus.channel))).stdout)
        return link["linkinfo"]["info_kind"] in ("vcan", "vxcan")
    except (OSError, subprocess.SubprocessError, ValueError, KeyError, TypeError):
        return False


def _question(channel: str) -> list[str]:
    return ["ip", "-details", "-statistics", "-json", "link", "show", "dev", channel]


def require_preflight(
    buses: Iterable[tuple[BusSettings | LineSettings, int]], run: Runner | None = None
) -> list[PreflightFinding]:
    """Check the CAN interfaces before a run; return the notes, and raise if one is unfit.

    Raises:
        LinkError: A run is refused; lists every reason.
    """
    findings = preflight(buses, run)
    refused = [f for f in findings if f.severity == "refused"]
    if refused:
        raise LinkError("; ".join(f"{f.interface}: {f.item}: got {f.seen}, {f.text}" for f in refused))
    return [f for f in findings if f.severity == "note"]


def _inspect_interface(channel: str, bus: BusSettings, axes: int, run: Runner) -> list[PreflightFinding]:
    """Judge one interface.

    Args:
        channel: Name of the interface.
        bus: Settings of the bus.
        axes: Number of drives on the bus.
        run: Function that runs a command and returns its output.
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
    """Return the findings on an interface, from its entry in the output of `ip -json`."""
    rows = _rows(channel, link, bus, axes)
    return [PreflightFinding(channel, item, str(seen), severity, text) for item, seen, severity, text in rows]


def _rows(channel: str, link: Mapping[str, Any], bus: BusSettings, axes: int) -> Iterator[Row]:
    if link.get("link_type") != "can":
        text = "expected can; name a CAN interface in bus.channel"
        yield row("link type", link.get("link_type"), "refused", text)
        return
    is_up, info = "UP" in link.get("flags", []), link.get("linkinfo") or {}
    command = f"ip link set {channel} up type can bitrate {bus.bitrate}"
    yield row("link", "up" if is_up else "down", "refused", f"expected up; {command}", good=is_up)
    length, needed = link.get("txqlen"), 2 * (axes + 3)  # a shorter queue refuses frames (ENOBUFS) at the first delay
    if isinstance(length, int):
        command = f"ip link set {channel} txqueuelen {4 * needed}"
        text = f"expected at least {needed} (two cycles of {axes} axes); {command}"
        yield row("txqueuelen", length, "note", text, good=length >= needed)
    if info.get("info_kind") == "can":  # vcan and vxcan have no controller
        yield from _of_controller(channel, info.get("info_data") or {}, info.get("info_xstats") or {}, bus)
    else:
        yield row("controller", f"none ({info.get('info_kind')})", "well")


def _of_controller(
    channel: str, data: Mapping[str, Any], statistics: Mapping[str, int], bus: BusSettings
) -> Iterator[Row]:
    bitrate = (data.get("bittiming") or {}).get("bitrate", data.get("bittiming_bitrate"))
    if bitrate is None:
        yield row("bit rate", "not reported", "note", f"cannot be compared with bus.bitrate {bus.bitrate}")
    else:
        command = f"ip link set {channel} down; ip link set {channel} up type can bitrate {bus.bitrate}"
        text = f"expected {bus.bitrate} as bus.bitrate says; correct it, or: {command}"
        yield row("bit rate", bitrate, "refused", text, good=bitrate == bus.bitrate)
    yield _of_state(channel, str(data.get("state", "not reported")))
    for mode in ("LISTEN-ONLY", "LOOPBACK", "ONE-SHOT"):
        if mode in (data.get("ctrlmode") or []):
            link = f"ip link set {channel}"
            text = f"expected an ordinary controller; {link} down; {link} up type can {mode.lower()} off"
            yield row("mode", mode, "refused", text)
    yield _of_restart(channel, data.get("restart_ms"), bus)
    counters = data.get("berr_counter") or {}
    worst = max((int(counters.get(side, 0)) for side in ("tx", "rx")), default=0)
    seen = f"tx {counters.get('tx', '?')}, rx {counters.get('rx', '?')}"
    text = f"expected below {_ALARMING_ERRORS}; check cable, termination, bit rate"
    yield row("error counters", seen, "note", text, good=worst < _ALARMING_ERRORS)
    if offs := statistics.get("bus_off", 0):
        yield row("bus-offs so far", offs, "note", "expected none since the interface came up; find the cause")


def _of_state(channel: str, state: str) -> Row:
    if state == "BUS-OFF":
        text = "expected ERROR-ACTIVE; find the cause (cable, termination, a node with another bit rate), then"
        return row("state", state, "refused", f"{text}: ip link set {channel} type can restart")
    if state in ("STOPPED", "SLEEPING"):
        return row("state", state, "refused", f"expected ERROR-ACTIVE; ip link set {channel} up")
    text = "expected ERROR-ACTIVE; no node acknowledges, or cable and termination are bad"
    return row("state", state, "note", text, good=state == "ERROR-ACTIVE")


def _least_restart(bus: BusSettings) -> int:
    """Return the shortest delay of an automatic restart after bus-off [ms] that lets the rig stop before."""
    return math.ceil(bus.stop_cycles * bus.sample_time * 1e3)


def _of_restart(channel: str, restart: object, bus: BusSettings) -> Row:
    if not isinstance(restart, int):
        return row("restart-ms", "not reported", "note", "cannot be checked; set `restart-ms 0`")
    least = _least_restart(bus)
    if restart and restart < least:
        why = f"(after {bus.stop_cycles} sample times the rig has stopped), so that a bus-off ends the run"
        text = f"expected 0, or at least {least} ms {why}"
        return row("restart-ms", f"{restart} ms", "refused", f"{text}; ip link set {channel} type can restart-ms 0")
    text = "after a bus-off the interface restarts, but the run has ended" if restart else ""
    return row("restart-ms", f"{restart} ms" if restart else "0 (by hand)", "well", text)


def _run(command: list[str]) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(command, capture_output=True, text=True, timeout=5.0, check=False)

"""Preflight of the network interface of an EtherCAT line: whether it is there, up, for the drives alone, and prompt.

The kernel's own tables are read, and the driver is asked as `ethtool` asks it; nothing is changed.
"""

import socket
import struct
from array import array
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from canhaptic.host import capabilities
from canhaptic.host.findings import PreflightFinding, Row, row

_ETHTOOL: Final = 0x8946  # ioctl SIOCETHTOOL
_OFFLOADS: Final = {"gro": 0x2B, "gso": 0x23, "tso": 0x1E}  # ETHTOOL_GGRO, _GGSO, _GTSO
_COALESCING: Final = 0x0E  # ETHTOOL_GCOALESCE
_COALESCE: Final = struct.Struct("=23I")
_LONGEST_US: Final = 10  # that an interface may hold a frame back
_ROUTES: Final = Path("/proc/net/route")

Asker = Callable[[str, int, int], bytes | None]


def inspect_interface(interface: str, ask: "Asker | None" = None) -> list[PreflightFinding]:
    """Judge the interface of one EtherCAT line.

    Args:
        interface: Its name.
        ask: Function that asks the driver: interface, command and size; None where the driver does not answer.
    """
    rows = _rows(interface, ask or _asked)
    return [PreflightFinding(interface, item, str(seen), severity, text) for item, seen, severity, text in rows]


def _rows(interface: str, ask: Asker) -> Iterator[Row]:
    if not (capabilities.INTERFACES / interface).exists():
        yield row("interface", "none", "refused", capabilities.opening_objection(interface))
        return
    is_up = capabilities.is_up(interface)
    yield row("link", "up" if is_up else "down", "refused", f"expected up; ip link set {interface} up", good=is_up)
    is_default = interface in default_routes()
    text = "expected an interface for the drives alone, this one leads to the network; give the drives one of their own"
    yield row("default route", "here" if is_default else "elsewhere", "refused", text, good=not is_default)
    bridge = capabilities.INTERFACES / interface / "master"
    seen = bridge.resolve().name if bridge.exists() else "none"
    text = f"expected none: it would forward the frames; ip link set {interface} nomaster"
    yield row("bridge", seen, "refused", text, good=seen == "none")
    lacking = capabilities.lacking()
    text = f"expected both; run as root, or once: {capabilities.grant()}"
    yield row("capabilities", f"without {' and '.join(lacking)}" if lacking else "granted", "refused", text,
              good=not lacking)  # fmt: skip
    yield from _of_driver(interface, ask)


def _of_driver(interface: str, ask: Asker) -> Iterator[Row]:
    """Yield offloads and coalescing: what makes frames wait for others."""
    answers = {name: ask(interface, command, 8) for name, command in _OFFLOADS.items()}
    on = [name for name, answer in answers.items() if answer is not None and answer[4]]
    text = f"expected off: frames may wait for others; ethtool -K {interface} {' '.join(f'{name} off' for name in on)}"
    seen = "not reported" if all(answer is None for answer in answers.values()) else f"{', '.join(on) or 'none'} on"
    yield row("offloads", seen, "note", text, good=not on)
    answer = ask(interface, _COALESCING, _COALESCE.size)
    if answer is None:
        yield row("coalescing", "not reported", "well")
        return
    values = _COALESCE.unpack(answer)
    waits = {"rx-usecs": values[1], "tx-usecs": values[5]}
    long = {name: value for name, value in waits.items() if value > _LONGEST_US}
    command = f"ethtool -C {interface} {' '.join(f'{name} 0' for name in long)}"
    text = f"expected at most {_LONGEST_US} us: each frame is held back so long; {command}"
    yield row("coalescing", ", ".join(f"{name} {value}" for name, value in waits.items()), "note", text, good=not long)


def default_routes() -> set[str]:
    """Return the interfaces to which a default route leads."""
    found = set[str]()
    with suppress(OSError):
        for line in _ROUTES.read_text(encoding="ascii").splitlines()[1:]:
            words = line.split()
            if len(words) > 7 and words[1] == words[7] == "00000000":
                found.add(words[0])
    return found


def _asked(interface: str, command: int, size: int) -> bytes | None:
    """Return the answer of the driver, `size` bytes; None where it does not answer."""
    try:
        from fcntl import ioctl

        data = array("B", struct.pack("=I", command).ljust(size, b"\0"))
        request = struct.pack("16sP", interface.encode(), data.buffer_info()[0]).ljust(40, b"\0")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
            ioctl(asker, _ETHTOOL, request)
    except (ImportError, OSError):
        return None
    return data.tobytes()

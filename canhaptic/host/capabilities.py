"""The capabilities that a raw network interface needs (Linux): raised to open it, and lowered at once afterwards.

pysoem needs CAP_NET_RAW for the socket, and CAP_NET_ADMIN since it makes the interface promiscuous. A thread keeps
them as permitted, so that it can open an interface again; everything else runs without.
"""

import ctypes
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

_NEEDED: Final = {"CAP_NET_RAW": 13, "CAP_NET_ADMIN": 12}
_VERSION: Final = 0x20080522  # of the calls: two words of 32 bits each
INTERFACES: Final = Path("/sys/class/net")


class _Header(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint32), ("pid", ctypes.c_int))


class _Data(ctypes.Structure):
    _fields_ = (("effective", ctypes.c_uint32), ("permitted", ctypes.c_uint32), ("inheritable", ctypes.c_uint32))


def _call(name: str, data: "ctypes.Array[_Data]") -> bool:
    """Call capget or capset for this thread; return whether it worked."""
    try:
        call = getattr(ctypes.CDLL(None, use_errno=True), name)
    except (OSError, AttributeError, TypeError):  # not Linux
        return False
    return int(call(ctypes.byref(_Header(_VERSION, 0)), data)) == 0


def effective() -> frozenset[str]:
    """Return which of the two capabilities this thread has in effect."""
    return _those_in("effective")


def permitted() -> frozenset[str]:
    """Return which of the two capabilities this thread may raise."""
    return _those_in("permitted")


def _those_in(name: str) -> frozenset[str]:
    data = (_Data * 2)()
    bits = getattr(data[0], name) if _call("capget", data) else 0
    return frozenset(name for name, bit in _NEEDED.items() if bits >> bit & 1)


def lacking() -> list[str]:
    """Return which of the two capabilities this thread may not raise, in alphabetical order."""
    return sorted(_NEEDED.keys() - permitted())


@contextmanager
def raised() -> Iterator[None]:
    """Raise both capabilities as far as they are permitted; lower them again at the end."""
    _set(is_raised=True)
    try:
        yield
    finally:
        _set(is_raised=False)


def _set(*, is_raised: bool) -> None:
    data = (_Data * 2)()
    if not _call("capget", data):
        return
    for bit in _NEEDED.values():
        mask = 1 << bit
        data[0].inheritable &= ~mask
        if is_raised:
            data[0].effective |= data[0].permitted & mask
        else:
            data[0].effective &= ~mask
    _call("capset", data)


def grant() -> str:
    """Return the command that gives this Python both capabilities."""
    return f"sudo setcap cap_net_raw,cap_net_admin+ep {Path(sys.executable).resolve()}"


def opening_objection(interface: str) -> str:
    """Return why an interface for raw frames could not be opened, and the remedy.

    Args:
        interface: Its name.
    """
    place = f"bus.interface {interface!r}"
    if not sys.platform.startswith("linux"):
        return f"{place}: got {sys.platform}, expected Linux: raw frames are sent there only"
    if not (INTERFACES / interface).exists():
        known = ", ".join(name for _, name in socket.if_nameindex() if name != "lo") or "none"
        return f"{place}: got no such interface, expected one of: {known}; see `ip link`"
    if missing := lacking():
        text = f"{place}: cannot be opened without {' and '.join(missing)}"
        return f"{text}; as root, or once: {grant()}"
    if not is_up(interface):
        return f"{place}: is down; sudo ip link set {interface} up"
    return f"{place}: cannot be opened; see `ip -details link show {interface}`"


def is_up(interface: str) -> bool:
    """Return whether an interface is up."""
    with suppress(OSError, ValueError):
        return bool(int((INTERFACES / interface / "flags").read_text(encoding="ascii"), 16) & 1)
    return False

"""A veth pair with the simulated drives behind one end, for masters on the other. Needs root."""

import itertools
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from canhaptic.drive.clock import WallClock

ROOT = Path(__file__).resolve().parents[2]
SCENE = ROOT / "configs" / "ethercat.yaml"
REALTIME = ("bus.realtime.priority=20", "bus.realtime.cpus=[0]", "bus.realtime.freeze_garbage=true")
_NUMBERS = itertools.count()


def require(*modules: str) -> None:
    """Skip, visibly, where something that a test needs is not here."""
    if not hasattr(os, "geteuid") or os.geteuid() != 0:
        pytest.skip("needs root: raw sockets and `ip link`")
    if shutil.which("ip") is None:
        pytest.skip("iproute2 is not installed (apt-get install iproute2)")
    for name in modules:
        pytest.importorskip(name, reason=f"{name} is not installed (pip install {name})")


def _ip(*words: str) -> None:
    subprocess.run(["ip", "link", *words], check=True, capture_output=True, timeout=10)


@contextmanager
def veth() -> Iterator[tuple[str, str]]:
    """Both ends of a new pair, up and without the chatter of IPv6."""
    stem = f"ec{os.getpid() % 100_000}{next(_NUMBERS) % 100:02d}"
    ends = f"{stem}a", f"{stem}b"
    try:
        _ip("add", ends[0], "type", "veth", "peer", "name", ends[1])
    except subprocess.CalledProcessError as error:
        pytest.skip(f"no veth pair here: {error.stderr}")
    try:
        for end in ends:
            Path(f"/proc/sys/net/ipv6/conf/{end}/disable_ipv6").write_text("1", encoding="ascii")
            _ip("set", end, "up")
        yield ends
    finally:
        _ip("delete", ends[0])


class FarEnd:
    """The simulated drives of a scene behind an interface, in a process of their own."""

    def __init__(self, interface: str, scene: Path = SCENE, *overrides: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.wire.far_end", interface, str(scene), *overrides],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
        )  # fmt: skip
        assert self._process.stdout is not None
        assert self._process.stdin is not None
        self._out, self._in = self._process.stdout, self._process.stdin
        assert self._out.readline() == "ready\n"

    def ask(self, command: str = "state") -> list[dict[str, Any]]:
        self._in.write(f"{command}\n")
        self._in.flush()
        answer: list[dict[str, Any]] = json.loads(self._out.readline())
        return answer

    def close(self) -> None:
        self._in.close()
        self._process.wait(timeout=10)
        self._out.close()

    def __enter__(self) -> "FarEnd":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def command(*words: str) -> list[str]:
    """The command line of `canhaptic`."""
    return [sys.executable, "-m", "canhaptic", *words]


def wait(seconds: float) -> None:
    clock = WallClock()
    clock.wait_until(clock.now() + round(seconds * 1e9))


def sets(*overrides: str) -> list[str]:
    return [word for of in overrides for word in ("--set", of)]

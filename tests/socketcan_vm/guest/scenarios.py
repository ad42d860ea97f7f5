"""Runs inside the guest: brings CAN interfaces up, runs `canhaptic` over them, and prints what the frames say as JSON.

Every line `RESULT {...}` is one scenario. Frames are read from the kernel by a socket of this program's own, with the
kernel's time stamps, and judged by their bytes.
"""

import importlib
import json
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from canhaptic.cli.main import main as command_line

SCENE = "/packages/configs/demo.yaml"
EXAMPLE = "/packages/configs/socketcan_example.yaml"
FIRST = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30)); "  # answers before anybody else runs
HAND_IN_THE_WALL = ["--set", "simulation.user.rest=-0.2 m"]
RATE = 360  # [Hz]; a cycle of both processes takes 1.3 ms of this processor
SYNC, TPDO, RPDO = 0x080, 0x181, 0x201
TIMESTAMP_NS = 35  # SO_TIMESTAMPNS of <asm-generic/socket.h>
RCVBUF_FORCE = 33  # SO_RCVBUFFORCE: more than net.core.rmem_max, as root
PATIENCE = 120.0  # [s] of the guest's time


class Frame(NamedTuple):
    """One frame as the kernel saw it."""

    time: float  # [s]
    can_id: int
    data: bytes


class Listener:
    """A raw socket on one interface."""

    def __init__(self, channel: str) -> None:
        self.socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self.socket.setsockopt(socket.SOL_SOCKET, TIMESTAMP_NS, 1)
        self.socket.setsockopt(socket.SOL_SOCKET, RCVBUF_FORCE, 1 << 25)
        self.socket.bind((channel,))
        self.frames: list[Frame] = []

    def hear(self, seconds: float) -> Frame | None:
        if not select.select([self.socket], [], [], seconds)[0]:
            return None
        packed, extra, _flags, _address = self.socket.recvmsg(16, 64)
        can_id, length = struct.unpack_from("<IB", packed)
        [(_level, _kind, stamp)] = extra
        whole, nano = struct.unpack("<qq", stamp)
        frame = Frame(whole + nano * 1e-9, can_id & 0x7FF, packed[8 : 8 + length])
        self.frames.append(frame)
        return frame

    def drain(self) -> list[Frame]:
        while self.hear(0.0) is not None:
            pass
        self.socket.close()
        return self.frames


class Usage:
    """Notes how much processor each process took, five times a second, in a thread of its own."""

    def __init__(self) -> None:
        self.samples: list[tuple[float, dict[str, int]]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> "Usage":
        self._busy = _busy()
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._ended.set()
        self._thread.join()
        now = _busy()
        self.busy = (now[0] - self._busy[0]) / max(1, now[1] - self._busy[1])

    def _watch(self) -> None:
        while not self._ended.wait(0.2):
            self.samples.append((time.clock_gettime(time.CLOCK_REALTIME), _taken()))

    def around(self, moment: float) -> dict[str, float]:
        """Returns what each process took in the stretch around a moment [ms]; those of less than 0.1 ms left out."""
        for (begin, before), (end, after) in pairwise(self.samples):
            if begin <= moment <= end:
                took = {name: (value - before.get(name, 0)) * 1e-6 for name, value in after.items()}
                return {"stretch": 1e3 * (end - begin), **{name: ms for name, ms in took.items() if ms >= 0.1}}
        return {}


def _busy() -> tuple[int, int]:
    """Returns the ticks in which the processor was busy, and all of them."""
    ticks = [int(word) for word in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    return sum(ticks) - ticks[3] - ticks[4], sum(ticks)


def _taken() -> dict[str, int]:
    """Returns the time that each process took so far [ns]."""
    found = {}
    for place in Path("/proc").glob("[0-9]*/task/[0-9]*/schedstat"):
        try:
            name = place.with_name("comm").read_text().strip()
            found[f"{name} {place.parts[2]}/{place.parts[4]}"] = int(place.read_text().split()[0])
        except OSError:  # it has ended
            continue
    return found


def torque(frame: Frame) -> int:
    """Target torque of an RPDO1 (controlword, target torque) [per mille]."""
    return int(struct.unpack_from("<h", frame.data, 2)[0])


class Forked:
    """The command in a process forked from this one, with what is used here of `subprocess.Popen`.

    This one has imported the package: the imports are nearly all the work of a start, which the emulated processor
    does in half a minute.
    """

    def __init__(self, words: Sequence[str], is_first: bool) -> None:
        reading, writing = os.pipe()
        self._out = tempfile.TemporaryFile("w+")  # noqa: SIM115 - open as long as the process
        self.returncode: int | None = None
        self.pid = os.fork()
        if not self.pid:
            os.dup2(self._out.fileno(), 1)
            os.dup2(writing, 2)
            _become(words, is_first)
        os.close(writing)
        self.stderr = os.fdopen(reading)

    def poll(self) -> int | None:
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if pid else None
        return self.returncode

    def communicate(self, timeout: float = PATIENCE) -> tuple[str, str]:
        if self.poll() is None:
            descriptor = os.pidfd_open(self.pid)
            ended = select.select([descriptor], [], [], timeout)[0]
            os.close(descriptor)
            if not ended:
                raise subprocess.TimeoutExpired("canhaptic", timeout)
            self.poll()
        self._out.seek(0)
        return self._out.read(), self.stderr.read()

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)


def _become(words: Sequence[str], is_first: bool) -> NoReturn:
    status = 1
    try:
        if is_first:
            exec(FIRST)
        status = command_line(list(words))
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


@contextmanager
def canhaptic(*words: str, is_first: bool = False) -> Iterator[Forked]:
    """The command in a process of its own, gone at the end of the block."""
    process = Forked(words, is_first)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGKILL)


def import_all() -> None:
    """Imports what `run` and `drive` import, by a short run on a virtual bus."""
    importlib.import_module("canhaptic.cli.drive")
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        command_line(["run", SCENE, "--duration", "0.01", "--json"])


def on_bus(channel: str) -> list[str]:
    values = ["bus.interface=socketcan", f"bus.channel={channel}", f"bus.rate={RATE} Hz"]
    values += ["bus.spin_margin=0 s", "bus.tpdo_timeout=0.8"]  # one processor of 10^9 instructions a second for both
    values += ["bus.realtime.priority=20", "bus.realtime.freeze_garbage=true"]
    values += ["passivity.sync_jitter=0.05", "passivity.torque_window=0.1 ms", "passivity.current_lag=10 us"]
    values += ["passivity.device_friction_bound=0 N"]
    values += ["axes.0.torque_verified=mass", "axes.0.position_reference=absolute"]
    return [word for value in values for word in ("--set", value)]


def whole_run(
    master: str, drive: str, seconds: float, scene: str = SCENE, *, is_logged: bool = False
) -> dict[str, Any]:
    """Two processes over one bus, and the writer of a log: start, contact, stop. The master may have its own scene."""
    listener = Listener(master)
    far_words = "drive", SCENE, *on_bus(drive), *HAND_IN_THE_WALL
    with canhaptic(*far_words, is_first=True) as far:
        assert far.stderr is not None
        powered = far.stderr.readline()
        command = ["run", scene, *on_bus(master), "--pace", "real", "--duration", str(seconds), "--json"]
        command += ["--bus-log", "/tmp/run.log"] if is_logged else []
        with canhaptic(*command) as near, Usage() as usage:
            out, err = near.communicate(timeout=PATIENCE)
        far.send_signal(signal.SIGTERM)
        far.communicate(timeout=PATIENCE)
        ends = [near.returncode, far.returncode]
    frames = listener.drain()
    syncs = [frame.time for frame in frames if frame.can_id == SYNC]
    gaps = [later - earlier for earlier, later in pairwise(syncs)]
    account = json.loads(out) if ends[0] == 0 else {}
    return {
        "powered": powered.strip(), "ends": ends, "error": err.strip()[-800:], "account": account,
        "syncs": len(syncs), "tpdos": count(frames, TPDO), "rpdos": count(frames, RPDO),
        "late": [[n, gap, usage.around(syncs[n])] for n, gap in enumerate(gaps) if gap > 1.5 / RATE],
        "busy": busy_between(usage, syncs),
        "processes": {"master": near.pid, "drive": far.pid, "listener": os.getpid()},
        "shortest_gap": min(gaps, default=0.0),
        "most_torque": max((abs(torque(frame)) for frame in frames if frame.can_id == RPDO), default=0),
        "last_torque": [torque(frame) for frame in frames if frame.can_id == RPDO][-1:],
    }  # fmt: skip


def busy_between(usage: Usage, syncs: list[float]) -> float:
    """Returns the share of the processor that all processes took while SYNCs were sent."""
    during = [one for one in usage.samples if syncs and syncs[0] <= one[0] <= syncs[-1]]
    if len(during) < 2:
        return usage.busy
    (begin, before), (end, after) = during[0], during[-1]
    return sum(value - before.get(name, 0) for name, value in after.items()) * 1e-9 / (end - begin)


def count(frames: list[Frame], can_id: int) -> int:
    return sum(frame.can_id == can_id for frame in frames)


def cut_off(master: str, drive: str, how: str) -> dict[str, Any]:
    """In the middle of the contact the drive's interface goes down, or the drive's process is killed."""
    listener = Listener(master)
    with canhaptic("drive", SCENE, *on_bus(drive), *HAND_IN_THE_WALL, is_first=True) as far:
        assert far.stderr is not None
        far.stderr.readline()
        with canhaptic("run", SCENE, *on_bus(master), "--pace", "real", "--duration", "60") as near:
            pushed = 0
            while pushed < 100:
                frame = listener.hear(1.0)
                if frame is None and near.poll() is not None:
                    raise RuntimeError(f"the master ended before the contact: {near.communicate()}")
                pushed += frame is not None and frame.can_id == RPDO and abs(torque(frame)) > 50
            if how == "killed":
                far.send_signal(signal.SIGKILL)
            else:
                subprocess.run(["ip", "link", "set", drive, "down"], check=True)
            _out, err = near.communicate(timeout=PATIENCE)
            end = near.returncode
    if how != "killed":
        subprocess.run(["ip", "link", "set", drive, "up"], check=True)
    return {"ends": [end], "error": err.strip()[-1200:], **after_the_last_answer(listener.drain())}


def after_the_last_answer(frames: list[Frame]) -> dict[str, Any]:
    """What the master sent once the drive was silent, counted in SYNCs."""
    last = max(i for i, frame in enumerate(frames) if frame.can_id == TPDO)
    torques: list[list[int]] = []  # [SYNCs since the last answer, target torque]
    syncs = 0
    for frame in frames[last + 1 :]:
        syncs += frame.can_id == SYNC
        if frame.can_id == RPDO:
            torques.append([syncs, torque(frame)])
    zero = [at for at, value in torques if value == 0]
    return {
        "held": torques[0][1] if torques else None,
        "syncs_to_zero": zero[0] if zero else None,
        "torque_after_zero": any(value for at, value in torques if zero and at > zero[0]),
        "torques": torques[:40],
    }


def link(*words: str) -> None:
    subprocess.run(["ip", "link", *words], check=True)


def main() -> None:
    """Runs every scenario; one that fails says so and does not stop the others."""
    Path("/proc/sys/kernel/sched_rt_runtime_us").write_text("-1")  # else the kernel stalls both for 50 ms at 95 % load
    for name in ("vcan0", "vcan1"):
        link("add", "dev", name, "type", "vcan")
        link("set", name, "up")
    for name in ("can0", "can1"):
        link("set", name, "up", "txqueuelen", "128", "type", "can", "bitrate", "1000000")
    seconds = 3.0  # 1080 cycles
    scenarios = {
        "vcan": lambda: whole_run("vcan0", "vcan0", seconds, is_logged=True),
        "example": lambda: whole_run("vcan1", "vcan1", 1.0, EXAMPLE),
        "kvaser": lambda: whole_run("can0", "can1", seconds),
        "link_down": lambda: cut_off("can0", "can1", "down"),
        "killed": lambda: cut_off("can0", "can1", "killed"),
    }
    begin = time.monotonic()
    import_all()
    print(f"TOOK importing {time.monotonic() - begin:.1f} s", flush=True)
    for name, scenario in scenarios.items():
        begin = time.monotonic()
        try:
            result = scenario()
        except Exception as error:  # one line a scenario, in any case
            result = {"failed": f"{type(error).__name__}: {error}"}
        print("RESULT", json.dumps({"scenario": name, **result}), flush=True)
        print(f"TOOK {name} {time.monotonic() - begin:.1f} s", flush=True)


main()

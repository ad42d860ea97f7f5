"""Two rigs, each a process in real time, over a relay: one is stopped, killed, started again, and has another key."""

import json
import os
import random
import select
import signal
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canhaptic.far.packet import HELLO, READY
from canhaptic.logs.energy_reader import EnergyLog
from tests.forked import Forked, command

PATIENCE = 40.0  # [s]
SILENCE = 150  # SYNCs, 0.3 s
RIGS = "configs/far_hand.yaml", "configs/far_wall.yaml"


class Relay:
    """Carries packets between two rigs: loses, doubles, changes and reflects some, and repeats old ones."""

    def __init__(self) -> None:
        ends = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(4)]
        for end in ends:
            end.bind(("127.0.0.1", 0))
        self.places = [end.getsockname() for end in ends]
        self.ends, probes = ends[:2], ends[2:]
        for probe in probes:
            probe.close()
        self.rigs = self.places[2:]  # where each rig listens
        self.flags, self.draw, self.old = [0, 0], random.Random(3), [b"", b""]
        self.hostile = 0  # packets that the first rig must refuse

    def carry(self, until: Callable[[], bool], patience: float = PATIENCE) -> bool:
        """Carries until something is so; returns whether it became so in time."""
        end = time.monotonic() + patience
        while not until():
            if time.monotonic() > end:
                return False
            for ready in select.select(self.ends, [], [], 0.05)[0]:
                self.pass_on(self.ends.index(ready), ready.recv(200))
        return True

    def pass_on(self, place: int, data: bytes) -> None:
        self.flags[place], draw = data[3], self.draw.random()
        if draw < 0.05:
            return
        for _ in range(2 if draw > 0.98 else 1):
            self.ends[1 - place].sendto(data, self.rigs[1 - place])
        if self.draw.random() < 0.1:
            changed = bytearray(data)
            changed[self.draw.randrange(16, len(data))] ^= 1 << self.draw.randrange(8)
            own = self.ends[place], self.rigs[place]
            for wrong in (changed, data, self.old[1 - place]):  # mutated and own ones come back, and one of long ago
                own[0].sendto(wrong, own[1])
            self.hostile += 2 if place == 0 else 0
        if self.draw.random() < 0.002:
            self.old[place] = data

    def are_linked(self) -> bool:
        return all(flags & READY and not flags & HELLO for flags in self.flags)


def starts(place: int, relay: Relay, folder: Path, key: str) -> Forked:
    """Starts one of the rigs as a process of its own."""
    changes = [
        "bus.rate=500 Hz", "bus.realtime.priority=20", f"far.silence={SILENCE / 500.0} s",
        f"far.key={folder / key}", f"far.peer=127.0.0.1:{relay.places[place][1]}", "simulation.far_network=null",
        f"far.listen=127.0.0.1:{relay.rigs[place][1]}", "passivity.hand_push=6 N",
        "far.coupling={type: spring, stiffness: 300 N/m, damping: 8 N*s/m}",
    ]  # fmt: skip
    if place == 0:
        changes += ["simulation.user.motion.frequency=1 Hz", "simulation.user.motion.amplitude=60 mm"]
    else:
        changes.remove("simulation.far_network=null")
    words = ["--pace", "real", "--duration", "120", "--json", "--log", str(folder / f"{place}.h5"), "--force"]
    return command("run", RIGS[place], *words, *(word for change in changes for word in ("--set", change)))


@pytest.mark.campaign
def test_the_rig_that_lives_lets_its_torque_go_and_links_again_and_believes_no_stranger(tmp_path: Path) -> None:
    for name, seed in (("link.key", b"a"), ("old.key", b"b")):
        (tmp_path / name).write_bytes(32 * seed)
        (tmp_path / name).chmod(0o600)
    relay, others = Relay(), list[Forked]()

    def second(key: str = "link.key") -> Forked:
        others.append(starts(1, relay, tmp_path, key))
        return others[-1]

    first, one = starts(0, relay, tmp_path, "link.key"), second()
    try:
        assert relay.carry(relay.are_linked), relay.flags
        relay.carry(lambda: False, 1.0)
        os.kill(one.pid, signal.SIGSTOP)
        relay.carry(lambda: False, 5.0)
        assert relay.flags[0] & HELLO  # the session has ended there
        os.kill(one.pid, signal.SIGCONT)
        out, _ = one.communicate(timeout=PATIENCE)
        assert "SYNCS_SKIPPED" in out
        one = second()
        assert relay.carry(relay.are_linked), relay.flags
        relay.carry(lambda: False, 1.0)
        one.kill()
        assert relay.carry(lambda: bool(relay.flags[0] & HELLO)), relay.flags
        one = second("old.key")
        assert not relay.carry(lambda: not relay.flags[0] & HELLO, 4.0)  # greetings of another key
        first.send_signal(signal.SIGINT)
        said, error = first.communicate(timeout=PATIENCE)
    finally:
        for process in (first, *others):
            process.kill()
            process.communicate()
        for end in relay.ends:
            end.close()
    judge(json.loads(said), relay, tmp_path / "0.h5", error)


def judge(said: dict[str, Any], relay: Relay, path: Path, error: str) -> None:
    """Judges what the rig that lived has said and logged."""
    assert said["status"] == "stopped", error
    assert said["far"]["sessions"] == 2
    assert said["far"]["received"] > 1e-3
    assert said["far"]["refused"] >= 0.8 * relay.hostile > 20
    port, least = said["ports"]["handle"], said["truth"]["handle"]["least_interaction"]
    assert least >= -1e-9 or port["verdict"] != "yes"
    assert least >= -1e-9 or said["link"]["skipped_syncs"] > 0
    with EnergyLog.open(path) as log:
        session, seen = log.far["session"], log.far["seen"]
        torque, index = log.ports["handle"]["torque_command"], log.timing["deadline_index"]
    ends = np.flatnonzero((session[1:] == 0) & (session[:-1] != 0)) + 1
    assert len(ends) == 2
    for end in ends:
        last = np.flatnonzero(seen[1:end] != seen[: end - 1])[-1] + 1  # SYNC of the last packet of it
        assert index[end] - index[last] <= SILENCE + 2
        gone = np.flatnonzero(index >= index[end] + 0.2 * 500 + 4)
        assert np.abs(torque[gone[:100]]).max() == 0.0
        assert np.abs(torque[last:end]).max() > 0.0  # it acted until then

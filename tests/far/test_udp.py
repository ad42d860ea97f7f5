"""Two rigs over real sockets, each stepped by hand: one that is still, is killed and starts again, and strangers."""

import contextlib
import socket
from dataclasses import replace
from typing import Any

import pytest

from canhaptic.cycle import running
from canhaptic.errors import InputError
from canhaptic.far.packet import READY, SIZE, Packet, pack
from canhaptic.far.port import IDLE, LINKED
from canhaptic.far.session import Session
from canhaptic.far.udp import UdpLink
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene

SOON = ["far.level=15 mJ", "far.silence=60 ms"]
HAND = load_scene("configs/far_hand.yaml", [*SOON, "simulation.user.motion.frequency=1.5 Hz"])
WALL = load_scene("configs/far_wall.yaml", SOON)


def free_address():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()


class Rigs:
    """Two rigs whose packets go through the sockets of this computer; each has a life of its own."""

    def __init__(self):
        self.places = free_address(), free_address()
        self.rigs: list[Any] = [None, None]
        self.least = [0.0, 0.0]
        self.stack = contextlib.ExitStack()
        self.kept = [0.0, 0.0]  # by the plants of lives that have ended [J]

    def start(self, place):
        own, other = self.places[place], self.places[1 - place]
        rig = build((HAND, WALL)[place], "free", to_far=(UdpLink(own, other), None))
        self.stack.enter_context(contextlib.suppress(Exception))
        self.stack.callback(rig.close)
        self.rigs[place] = rig
        self.stack.enter_context(running(rig.cycle))

    def kill(self, place):
        self.rigs[place].far.close()  # no word of farewell
        self.rigs[place] = None

    def step(self, *places, cycles):
        for _ in range(cycles):
            for place in places:
                rig = self.rigs[place]
                rig.cycle.step()
                truth = rig.cycle.judge.interaction[0]  # of the motor, less sent, plus received
                self.least[place] = min(self.least[place], truth)

    def state(self, place):
        return self.rigs[place].far.port.state


@pytest.fixture
def rigs():
    both = Rigs()
    with both.stack:
        both.start(0)
        both.start(1)
        yield both
    assert min(both.least) >= -1e-9


@pytest.mark.slow
def test_a_rig_that_is_still_and_one_that_is_killed_leave_the_other_without_torque_and_passive(rigs):
    rigs.step(0, 1, cycles=1200)
    assert rigs.state(0).blend == rigs.state(1).blend == 1.0
    sent = rigs.state(0).sent
    assert sent > 1e9
    rigs.step(0, cycles=62)  # the other process is stopped: its packets end
    assert not rigs.rigs[0].far.session.is_alive
    assert rigs.state(0).sent - sent < 1e12
    rigs.step(0, cycles=230)
    assert rigs.state(0).phase == IDLE
    assert rigs.rigs[0].cycle.rig.is_still
    rigs.step(0, 1, cycles=1800)  # it goes on: what it says is of a session that has ended
    assert rigs.state(0).phase == rigs.state(1).phase == LINKED
    assert rigs.rigs[0].far.session.sessions == 2
    rigs.kill(1)
    rigs.step(0, cycles=300)
    assert rigs.state(0).phase == IDLE
    rigs.start(1)
    rigs.step(0, 1, cycles=600)
    assert rigs.rigs[0].far.session.sessions == 3
    assert rigs.rigs[0].far.session.number == rigs.rigs[1].far.session.number


def test_a_stranger_is_dropped_by_the_kernel_and_forged_claims_by_their_tag():
    own, other = free_address(), free_address()
    link = UdpLink(own, other)
    rig = build(replace(HAND), "free", to_far=(link, None))
    forged = pack(Packet(0, 5, 77, 10**15, 0, 10**15, 0.0, 0.0, 0), bytes(32))
    with rig, running(rig.cycle), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        rig.cycle.step()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(forged, own)
        assert list(link.arrived()) == []
        peer.bind(other)
        for cycle in range(60):
            for _ in range(30):
                peer.sendto(forged[: SIZE - cycle % 3], own)
            rig.cycle.step()
            assert rig.cycle.rig.is_still
        summary = rig.far.summary()
    assert (summary.sessions, summary.received) == (0, 0.0)
    assert 0 < summary.refused <= 8 * 61


def test_a_peer_with_the_key_that_claims_a_kilojoule_makes_a_rig_give_out_from_far_and_no_more():
    own, other = free_address(), free_address()
    limits = [
        "far.from_far={energy: 40 mJ, power: 5 W}",
        "far.coupling={type: spring, stiffness: 200 N/m, damping: 4 N*s/m}",
    ]
    rig = build(load_scene("configs/far_wall.yaml", limits), "free", to_far=(UdpLink(own, other), None))
    peer, least = UdpLink(other, own), 0.0
    liar = Session(b"", 10**6, 1e15, iter(range(1, 100)).__next__, peer.send)
    with rig, running(rig.cycle):
        for cycle in range(700):
            liar.pass_time(1)
            for data in peer.arrived():
                liar.take(data, may_begin=True)
            far = 0.02 if cycle % 400 < 200 else -0.02  # where it says that it is
            liar.say((READY, 0, 0, 10**15, 10**15, 10**15, far, 0.0, 0, 0.0, 0.0))
            rig.cycle.step()
            least = min(least, rig.cycle.judge.interaction[0] - rig.cycle.ledgers[0].supplied)
        assert rig.far.summary().cut > 0
    peer.close()
    assert -0.04 - 1e-9 <= least <= -0.01


@pytest.mark.parametrize("has_poll", [True, False])
def test_what_has_arrived_is_taken_in_one_look_8_at_most(has_poll, monkeypatch):
    if not has_poll:
        monkeypatch.delattr("select.poll")  # not on every system
    own, other = free_address(), free_address()
    link, peer = UdpLink(own, other), UdpLink(other, own)
    assert list(link.arrived()) == []
    for number in range(20):
        peer.send(bytes([number]))
    assert list(link.arrived()) == [bytes([number]) for number in range(8)]
    assert [len(list(link.arrived())) for _ in range(3)] == [8, 4, 0]
    peer.close()
    link.send(b"x")  # the answer that no one listens there ends neither of them
    link.send(b"x")
    assert list(link.arrived()) == []
    link.close()


def test_an_own_address_that_is_taken_is_one_clear_error():
    own = free_address()
    first = UdpLink(own, free_address())
    with pytest.raises(InputError, match="give as `listen` an address"):
        UdpLink(own, free_address())
    first.close()

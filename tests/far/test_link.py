"""Packets and sessions of a link: what is not authentic, of another session or of oneself changes nothing."""

import random
import stat

import pytest

from canhaptic.cli.main import main
from canhaptic.errors import InputError
from canhaptic.far.packet import HELLO, ROLE, SIZE, STOPPING, Packet, pack, sent_in, unpack
from canhaptic.far.session import Session
from canhaptic.far.side import read_key

SECRET = bytes(range(32))
FULL = Packet(ROLE, 7, 1 << 61, 123, 456, 789, -0.25, 1.5, 3, 1000.0, 8.0)


class Ends:
    """Two sessions, each with the bytes that it has sent."""

    def __init__(self, secrets=(SECRET, SECRET), silence=50, owed=1e12):
        self.sent = [], []
        numbers = [iter(range(10, 99, 2)), iter(range(11, 99, 2))]
        self.sides = [
            Session(secret, silence, owed, numbers[place].__next__, self.sent[place].append)
            for place, secret in enumerate(secrets)
        ]

    def carry(self, place, data, *, may_begin=True):
        return self.sides[place].take(data, may_begin=may_begin)

    def turn(self, totals=(0, 0), periods=1, lossy=()):
        for place, side in enumerate(self.sides):
            side.pass_time(periods)
            side.say(Packet(0, 0, 0, totals[place], 0, 0, 0.0, 0.0, 0))
        for place in (0, 1):
            while self.sent[1 - place]:
                data = self.sent[1 - place].pop(0)
                if place not in lossy:
                    self.carry(place, data)

    def linked(self):
        for _ in range(200):
            self.turn()
        assert all(side.is_alive for side in self.sides)
        return self


def test_a_packet_has_80_bytes_and_says_what_was_put_in():
    data = pack(FULL, SECRET)
    assert (len(data), unpack(data, SECRET), sent_in(data)) == (SIZE, FULL, 123)
    assert data[:4] == b"CH\x01\x01"
    assert unpack(data, bytes(32)) is None


@pytest.mark.parametrize("wrong", [{"position": float("nan")}, {"velocity": float("inf")}, {"sent": -1}])
def test_numbers_that_no_side_sends_are_refused_with_a_true_tag_too(wrong):
    assert unpack(pack(FULL._replace(**wrong), SECRET), SECRET) is None


@pytest.mark.parametrize("packets", [2000, pytest.param(1_000_000, marks=(pytest.mark.slow, pytest.mark.campaign))])
def test_no_mutated_packet_is_authentic(packets):
    draw, data = random.Random(5), pack(FULL, SECRET)
    for _ in range(packets):
        changed = bytearray(data)
        for _ in range(draw.randint(1, 4)):
            changed[draw.randrange(SIZE)] ^= 1 << draw.randrange(8)
        assert bytes(changed) == data or unpack(bytes(changed), SECRET) is None
    assert unpack(data[:-1], SECRET) is unpack(data + b"x", SECRET) is unpack(b"", SECRET) is None


def test_a_session_begins_with_numbers_of_both_and_counts_the_largest_total_once():
    ends = Ends().linked()
    ends.turn((5, 3))
    ends.turn((9, 3))
    assert (ends.sides[1].most_received, ends.sides[0].most_sent, ends.sides[1].supplied) == (9, 9, 9 - 3)
    assert ends.sides[0].number == ends.sides[1].number > 0
    assert ends.sides[0].round_trip >= 1


def test_own_packets_old_ones_and_those_of_another_key_are_refused():
    ends = Ends().linked()
    ends.sides[0].say(Packet(0, 0, 0, 77, 0, 0, 0.0, 0.0, 0))
    own = ends.sent[0].pop()
    assert ends.carry(0, own) is None
    assert ends.sides[0].most_received == 0
    assert ends.carry(1, own).sent == 77
    ends.sides[1].end()
    ends.linked()
    assert ends.sides[1].sessions == 2
    assert ends.carry(1, own) is None
    assert ends.sides[1].most_received == 0
    strangers = Ends((SECRET, bytes(32)))
    for _ in range(100):
        strangers.turn()
    assert not any(side.is_alive for side in strangers.sides)
    assert min(side.refused for side in strangers.sides) > 0


def test_silence_and_a_stop_end_a_session_and_a_restarted_side_cannot_continue_it():
    ends = Ends().linked()
    number = ends.sides[0].number
    for _ in range(60):
        ends.turn(lossy=(0,))  # nothing reaches the first
    assert not ends.sides[0].is_alive
    ends.linked()
    assert ends.sides[0].number != number
    ends.sides[0].say(Packet(STOPPING, 0, 0, 4, 0, 0, 0.0, 0.0, 0))
    assert ends.carry(1, ends.sent[0].pop()).sent == 4
    assert not ends.sides[1].is_alive


def test_a_packet_that_is_sent_again_keeps_no_session_alive():
    ends = Ends().linked()
    ends.sides[0].say(Packet(0, 0, 0, 9, 0, 0, 0.0, 0.0, 0))
    old = ends.sent[0].pop()
    for cycle in range(51):
        assert ends.sides[1].is_alive, cycle
        assert ends.carry(1, old).sent == 9
        ends.sides[1].pass_time(1)
    assert not ends.sides[1].is_alive


def test_a_session_ends_before_its_numbers_do():
    ends = Ends().linked()
    number = ends.sides[0].number
    ends.sides[0]._seq = (1 << 32) - 2
    for _ in range(3):
        ends.turn()
    assert not ends.sides[0].is_alive
    assert ends.linked().sides[0].number != number


def test_a_greeting_that_is_sent_again_begins_nothing():
    ends = Ends()
    ends.sides[0].say(FULL)
    old = ends.sent[0].pop()
    assert unpack(old, SECRET).flags & HELLO
    ends.linked()
    ends.sides[1].end()
    for _ in range(3):
        ends.carry(1, old)
    assert not ends.sides[1].is_alive


def test_no_more_than_from_far_counts_as_received():
    ends = Ends(owed=10).linked()
    ends.turn((1000, 0))
    assert ends.sides[1].supplied == 10
    ends.turn((1000, 4))
    assert ends.sides[1].supplied == 10


def test_a_key_is_made_once_for_its_owner_and_read_with_its_length(tmp_path):
    path = tmp_path / "link.key"
    assert main(["new", "--far-key", str(path)]) == 0
    assert (len(read_key(path)), stat.S_IMODE(path.stat().st_mode)) == (32, 0o600)
    assert main(["new", "--far-key", str(path)]) != 0
    path.chmod(0o644)
    with pytest.raises(InputError, match="others can read"):
        read_key(path)
    path.chmod(0o600)
    path.write_bytes(b"short")
    with pytest.raises(InputError, match="got 5 bytes, expected a key of 32"):
        read_key(path)
    with pytest.raises(InputError, match="new --far-key"):
        read_key(tmp_path / "none")

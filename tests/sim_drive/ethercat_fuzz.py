"""Mutated EtherCAT frames into simulated drives, and mutated answers into the thin master."""

import random
import struct
from contextlib import suppress
from typing import Final

from canhaptic.drive.ethercat.segment import AlState, FrameKind
from canhaptic.errors import RigError, SdoError
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.sim_drive.ethercat_line import PERIOD, Line, make_drive

_STEP: Final = PERIOD // 3  # [ns] between two frames
_WORDS: Final = (
    *(0, 1, 2, 4, 7, 8, 0xFF, 0x100, 0x7F, 0x80, 0x0120, 0x0130, 0x0910, 0x0920, 0x0981, 0x09A0, 0x0FFC),
    *(0x1000, 0x1080, 0x1100, 0x1400, 0x7FF, 0x8000, 0xFFFF),
)


def mutated(frame: bytes, dice: random.Random) -> bytes:
    """Return a frame with one to four changes: of a bit, a byte, a word, a part, or its length."""
    content = bytearray(frame)
    for _ in range(dice.randint(1, 4)):
        at = 12 + int(max(1, len(content) - 12) * dice.random() ** 3)  # heads are at the beginning, padding at the end
        kind = dice.randrange(6)
        if at >= len(content):
            content += dice.randbytes(4)
        elif kind == 0:
            content[at] ^= 1 << dice.randrange(8)
        elif kind == 1:
            content[at] = dice.randrange(256)
        elif kind == 2:
            content[at : at + 2] = dice.choice(_WORDS).to_bytes(2, "little")
        elif kind == 3:
            other = dice.randrange(12, len(content))
            content[at : at + 8] = content[other : other + 8]
        elif kind == 4:
            del content[at : at + dice.randrange(20)]
        else:
            content[at:at] = dice.randbytes(dice.randrange(12))
    return bytes(content)


def any_mail(dice: random.Random) -> bytes:
    """Return a mail of 128 bytes with any length, kind, service and command, of which most are used."""
    length = dice.choice((dice.randrange(16), 10, dice.randrange(1 << 16)))
    kind, service = dice.choice((3, 3, 3, dice.randrange(16))), dice.choice((1, 2, 3, 8, dice.randrange(16)))
    head = struct.pack("<HHBBH", length, 0, 0, kind | dice.randrange(8) << 4, service << 12 | dice.choice((0, 7)))
    command = dice.choice(
        (0x40, 0x41, 0x23, 0x2F, 0x21, 0x60, 0x70, 0x00, 0x01, 0x11, 0x80, 1, 3, 5, dice.randrange(256))
    )
    index = dice.choice((0x1008, 0x1018, 0x1C12, 0x1600, 0x6040, 0x6060, 0x6071, 0x6072, dice.randrange(1 << 16)))
    body = struct.pack("<BHBI", command, index, dice.choice((0, 1, 255)), dice.choice((0, 1, 200, 0xFFFFFFFF)))
    return (head + body + dice.randbytes(112 * dice.randrange(2))).ljust(128, b"\0")


def with_mail(frame: bytes, dice: random.Random) -> bytes:
    """Return a frame whose first datagram, if it is one of a mailbox, has another mail."""
    is_mail = frame[16] in (4, 5) and frame[20:22] in (b"\x00\x10", b"\x80\x10") and len(frame) >= 156
    return frame[:26] + any_mail(dice) + frame[154:] if is_mail else mutated(frame, dice)


def corpus() -> list[tuple[int, bytes]]:
    """Return times [ns] and frames of a start and of some cycles, none of which asks for torque or enables a drive."""
    line, seen = Line(make_drive(), make_drive()), list[tuple[int, bytes]]()
    carry = line.cable.exchange

    def noted(frame: bytes, deadline: int) -> bytes | None:
        seen.append((line.clock.now(), frame))
        return carry(frame, deadline)

    line.master._exchange = noted
    line.configure()
    line.master.read(0, 0x1008, 0)
    for n in range(2):
        line.master.request(n, AlState.SAFE_OP)
    for _ in range(40):
        line.cycle(follow=False)
    for n in range(2):
        line.master.request(n, AlState.OP)
    for _ in range(10):
        line.cycle(follow=False)
        line.master.mail(0)
    return seen


def attack_drives(frames: int, seed: int) -> int:
    """Hand mutated frames to two drives in every AL state; return how many left a torque that none of them asked for.

    One frame in some 100,000 is by chance a whole command: it writes a controlword that enables, and a target.
    """
    dice, sent, torques = random.Random(seed), corpus(), 0
    mails = [(now, frame) for now, frame in sent if frame[16] == 5 and frame[20:22] == b"\x00\x10"]
    for start in range(0, frames, 500):
        line = Line(make_drive(), make_drive())
        for now, frame in sent[: dice.randrange(1, len(sent) + 1)]:
            line.cable.carry(frame, now)
        for _ in range(min(500, frames - start)):
            now += _STEP
            before = [drive.holds for drive in line.drives]
            change = dice.choice((mutated, with_mail))
            frame = change(dice.choice(mails if change is with_mail else sent)[1], dice)
            answer = line.cable.carry(frame, now)
            assert answer is not None
            assert len(answer) == len(frame)
            for drive, holds in zip(line.drives, before, strict=True):
                assert drive.holds - holds <= _STEP // 1000 + 1  # SYNC0 comes at most each microsecond
                assert drive.torque == 0.0 or drive.state is DriveState.OPERATION_ENABLED
                word = drive.store.find(0x6040)
                is_asked = drive.al_state == AlState.OP and word is not None and word.number & 0x0F == 0x0F
                torques += drive.torque != 0.0 and not is_asked
    return torques


def attack_master(runs: int, seed: int) -> int:
    """Let a thin master start and run drives whose answers are mutated now and then; return the answers so far.

    It raises the errors of a rig and no others.
    """
    dice, answers = random.Random(seed), 0
    for _ in range(runs):
        line, share = Line(make_drive(), make_drive()), dice.choice((0.002, 0.02, 0.2))
        carry = line.cable.exchange

        def damaged(frame: bytes, deadline: int, carry=carry, share=share) -> bytes | None:
            nonlocal answers
            answers += 1
            answer = carry(frame, deadline)
            return (
                answer if answer is None or dice.random() > share else dice.choice((mutated, with_mail))(answer, dice)
            )

        line.master._exchange = damaged
        try:
            line.configure()
            for index in (0x1008, 0x1018, 0x6072, 0x1008):
                with suppress(SdoError):
                    line.master.read(0, index, 0)
                    line.master.write(0, index, 0, bytes(200))
                line.master.mail(0)
            for n in range(2):
                line.master.request(n, AlState.SAFE_OP, 2_000_000)
        except RigError:
            continue
        for _ in range(40):
            for kind in FrameKind:
                line.master.exchange(kind, line.clock.now())
            line.clock.wait_until(line.clock.now() + _STEP)
    return answers

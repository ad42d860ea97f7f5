"""Simulated drives behind an interface, in a process that answers questions: what a foreign master did to them.

    python -m tests.wire.far_end INTERFACE SCENE [OVERRIDE...]

It prints a line when it is ready. For each line `state` that it reads it prints the drives as JSON.
"""

import gc
import json
import os
import select
import sys
from contextlib import suppress
from typing import Any

from canhaptic.drive.clock import WallClock
from canhaptic.scene.far_side import build_far_end
from canhaptic.scene.load import load_scene
from canhaptic.sim.drive.ethercat.drive_node import EthercatDrive
from canhaptic.sim.drive.ethercat.served_line import ServedLine

REGISTERS = {"managers": (0x810, 16), "fmmus": (0x600, 32), "delay": (0x928, 4), "assign_activate": (0x980, 2),
             "cycle": (0x9A0, 4), "watchdog": (0x420, 2), "divider": (0x400, 2)}  # fmt: skip


class Watch:
    """Writes of one drive, and when its torque ended.

    Attributes:
        writes: What the mailbox wrote: index, subindex, value.
        silence: Time from the last outputs until the drive left OP without torque [ns]; None before.
        torques: Looks at which it had a torque.
    """

    def __init__(self, drive: EthercatDrive) -> None:
        self.drive, self.writes = drive, list[tuple[int, int, int]]()
        self.silence: int | None = None
        self.torques = 0
        write = drive.store.write

        def noted(index: int, subindex: int, data: bytes) -> Any:
            self.writes.append((index, subindex, int.from_bytes(data, "little")))
            return write(index, subindex, data)

        vars(drive.store)["write"] = noted
        self._last = 0
        came, leave = drive.outputs_came, drive._leave

        def noted_outputs() -> None:
            self._last = drive.esc.now
            came()

        def noted_leave(emergency: int) -> None:
            silence = drive.servo.now - self._last
            leave(emergency)
            if drive.servo.torque == 0.0:
                self.silence = silence

        vars(drive).update(outputs_came=noted_outputs, _leave=noted_leave)

    def state(self) -> dict[str, Any]:
        drive, registers = self.drive, self.drive.esc.registers
        missed = drive.store.find(0x1C32, 11)
        return {
            "al_state": drive.al_state, "al_code": registers[0x134] | registers[0x135] << 8,
            "state": drive.state.name, "torque": drive.servo.torque, "torques": self.torques, "silence": self.silence,
            "holds": drive.holds, "missed": None if missed is None else missed.number, "writes": list(self.writes),
            "registers": {name: registers[at : at + size].hex() for name, (at, size) in REGISTERS.items()},
        }  # fmt: skip


def serve(interface: str, scene_file: str, *overrides: str) -> None:
    scene = load_scene(scene_file, overrides)
    cable, drives = build_far_end(scene, scene.bus_name)
    clock = WallClock(spin_margin=0.0)
    cable.use(clock)
    line = ServedLine(cable, interface)
    watches = [Watch(drive) for drive in drives]
    with suppress(OSError, AttributeError):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))
    gc.collect()
    gc.freeze()
    gc.disable()
    print("ready", flush=True)
    while True:
        wait = (line.next_due() - clock.now()) * 1e-9
        ready, _, _ = select.select([line, sys.stdin], [], [], min(0.05, max(0.0, wait)))
        now = clock.now()
        if line in ready and (frame := line.recv(0.0)) is not None:
            line.process(now, frame)
        else:
            line.process(now)
        for watch in watches:
            watch.torques += watch.drive.servo.torque != 0.0
        if sys.stdin in ready:
            command = sys.stdin.readline().split()
            if not command:
                return
            if command[0] == "fault":
                for drive in drives:
                    drive.inject_fault(int(command[1], 0))
            print(json.dumps([watch.state() for watch in watches]), flush=True)


if __name__ == "__main__":
    serve(*sys.argv[1:])

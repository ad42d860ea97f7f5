"""Boots the image and reads what it says on its serial line."""

import json
import subprocess
from collections.abc import Sequence
from typing import Any

from tests.socketcan_vm.image import Image

MEMORY = 1024  # [MiB]
SETTINGS = "console=ttyS0 quiet panic=-1 preempt=full transparent_hugepage=never"
"""Parameters of the kernel, the last two as for a rig: else its own work (`mm_percpu_wq`) may take 4 ms."""


def command(image: Image) -> list[str]:
    """Returns how QEMU is called: virtual time (one instruction a nanosecond), two SJA1000 controllers on one bus."""
    return [
        "qemu-system-x86_64", "-nodefaults", "-display", "none", "-no-reboot", "-serial", "stdio", "-m", str(MEMORY),
        "-cpu", "max", "-accel", "tcg,thread=single", "-icount", "shift=0,sleep=off",
        "-kernel", str(image.kernel), "-initrd", str(image.initial), "-append", SETTINGS,
        "-drive", f"file={image.root},if=virtio,format=raw,readonly=on",
        "-object", "can-bus,id=canbus0",
        "-device", "kvaser_pci,canbus=canbus0", "-device", "kvaser_pci,canbus=canbus0",
    ]  # fmt: skip


def boot(image: Image, timeout: float) -> tuple[dict[str, dict[str, Any]], str]:
    """Returns the results of every scenario by name, and everything that the machine printed.

    Raises:
        subprocess.TimeoutExpired: The machine did not power itself off in `timeout` [s]; carries its output.
    """
    done = subprocess.run(
        command(image), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        timeout=timeout, check=False, text=True, errors="replace", start_new_session=True,
    )  # fmt: skip
    return results(done.stdout.splitlines()), done.stdout


def results(lines: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Returns what follows `RESULT` on any line, by the name of its scenario."""
    found = [json.loads(line.split("RESULT ", 1)[1]) for line in lines if "RESULT {" in line]
    return {result["scenario"]: result for result in found}

"""Boots the machine again and again and judges each boot as the tests do: `python -m tests.socketcan_vm.boots 10`.

Prints one line for each boot, and for every SYNC that was skipped what each process took around it. Each boot begins
with the kernel: nothing is kept of the one before but the image. Exit status 1 where one was not green.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial

from tests.socketcan_vm import test_socketcan_vm as tests
from tests.socketcan_vm.image import PROJECT, build_image
from tests.socketcan_vm.machine import boot


def _judgements(results: tests.Results) -> Iterator[Callable[[], None]]:
    for bus in ("vcan", "kvaser"):
        yield partial(tests.test_a_whole_run_of_two_processes_loses_no_frame_and_skips_no_sync, results, bus)
        yield partial(tests.test_no_two_syncs_are_a_burst, results, bus)
    yield partial(tests.test_the_marked_example_runs_on_vcan_within_its_torque_limit, results)
    for how in ("link_down", "killed"):
        yield partial(tests.test_a_drive_that_is_cut_off_gets_zero_torque_within_the_policy, results, how)


def main(boots: int) -> int:
    """Returns how many boots were not green, at most 1."""
    folder = PROJECT / "build/socketcan_vm"
    folder.mkdir(parents=True, exist_ok=True)
    image, green = build_image(folder), 0
    for number in range(1, boots + 1):
        begin, cpu = time.monotonic(), os.times().children_user
        results, output = boot(image, tests.BOOT_TIMEOUT)
        wrong = [] if set(results) == tests.SCENARIOS else [f"scenarios {sorted(results)}: {output[-2000:]}"]
        for judge in [] if wrong else _judgements(results):
            try:
                judge()
            except AssertionError as error:
                wrong.append(str(error))
        green += not wrong
        busy = ", ".join(f"{name} {results[name]['busy']:.2f}" for name in ("vcan", "kvaser") if name in results)
        syncs = sum(run.get("syncs", 0) for run in results.values())
        took = f"{time.monotonic() - begin:.0f} s, of a processor {os.times().children_user - cpu:.0f} s"
        load = os.getloadavg()[0]
        print(
            f"boot {number}: {'green' if not wrong else 'RED'}, {took}, load of the host {load:.1f}; {syncs} SYNCs",
            end="; ",
        )
        print(f"guest busy: {busy}; most torque then zero after SYNCs:", *_to_zero(results), flush=True)
        for text in wrong:
            print(text, flush=True)
    print(f"{green} of {boots} boots green")
    return int(green < boots)


def _to_zero(results: tests.Results) -> list[str]:
    return [f"{how} {results[how]['syncs_to_zero']}" for how in ("link_down", "killed") if how in results]


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 10))

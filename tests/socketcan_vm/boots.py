"""Boots the machine again and again and judges each boot as the tests do.

    python -m tests.socketcan_vm.boots [BOOTS [AT_ONCE]]

Prints one line for each boot, and for every SYNC that was skipped what each process took around it. Each boot begins
with the kernel: nothing is kept of the one before but the image. Exit status 1 where one was not green.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from tests.socketcan_vm import test_socketcan_vm as tests
from tests.socketcan_vm.image import PROJECT, Image, build_image
from tests.socketcan_vm.machine import boot


def _judgements(results: tests.Results) -> Iterator[Callable[[], None]]:
    for bus in ("vcan", "kvaser"):
        yield partial(tests.test_a_whole_run_of_two_processes_loses_no_frame_and_skips_no_sync, results, bus)
        yield partial(tests.test_no_two_syncs_are_a_burst, results, bus)
    yield partial(tests.test_the_marked_example_runs_on_vcan_within_its_torque_limit, results)
    for how in ("link_down", "killed"):
        yield partial(tests.test_a_drive_that_is_cut_off_gets_zero_torque_within_the_policy, results, how)


def boot_once(image: Image, number: int) -> bool:
    """Boots once, prints what came of it, and returns whether it was green."""
    begin = time.monotonic()
    results, output = boot(image, tests.BOOT_TIMEOUT)
    wrong = [] if set(results) == tests.SCENARIOS else [f"scenarios {sorted(results)}: {output[-2000:]}"]
    for judge in [] if wrong else _judgements(results):
        try:
            judge()
        except AssertionError as error:
            wrong.append(str(error))
    busy = ", ".join(f"{name} {results[name]['busy']:.2f}" for name in ("vcan", "kvaser") if name in results)
    syncs = sum(run.get("syncs", 0) for run in results.values())
    late = sum(len(run.get("late", [])) for run in results.values())
    took = f"{time.monotonic() - begin:.0f} s at a load of the host of {os.getloadavg()[0]:.1f}"
    seen = f"{syncs} SYNCs, {late} late; guest busy: {busy}; SYNCs to zero torque: {' '.join(_to_zero(results))}"
    print(f"boot {number}: {'RED' if wrong else 'green'}, {took}; {seen}", *wrong, sep="\n  ", flush=True)
    return not wrong


def main(boots: int, at_once: int) -> int:
    """Returns the exit status: 1 where a boot was not green."""
    folder = PROJECT / "build/socketcan_vm"
    folder.mkdir(parents=True, exist_ok=True)
    image, begin = build_image(folder), os.times().children_user
    with ThreadPoolExecutor(at_once) as pool:
        green = sum(pool.map(partial(boot_once, image), range(1, boots + 1)))
    each = (os.times().children_user - begin) / boots
    print(f"{green} of {boots} boots green; {each:.0f} s of a processor each, {at_once} at once")
    return int(green < boots)


def _to_zero(results: tests.Results) -> list[str]:
    return [f"{how} {results[how]['syncs_to_zero']}" for how in ("link_down", "killed") if how in results]


if __name__ == "__main__":
    asked = [int(word) for word in sys.argv[1:]]
    sys.exit(main(*asked, *(10, 1)[len(asked) :]))

"""Commands on damaged files: `python -m tools.mutated_files [COUNT]`, COUNT mutants of a file for each command.

Each mutant is read by a copy of this process. Prints for each command the longest time, the most memory, the exit
statuses, and how many mutants ended in a traceback, a crash or never; exit status 1 where there is one. `fuzz` looks
for single readers' faults with coverage; this is the whole command.
"""

import importlib
import os
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from canhaptic.cli.main import main as canhaptic

_ROOT: Final = Path(__file__).parents[1]
_CONFIG: Final = str(_ROOT / "configs" / "demo.yaml")
_LONGEST: Final = 20  # [s] of a processor, after which a command counts as one that never ends
_WAITED: Final = 6
_TRACEBACK: Final = 99
_WELL: Final = frozenset({0, 1, 2, 3})


class Outcome(NamedTuple):
    """What came of one command."""

    status: int  # of the process; below 0 the signal that ended it
    seconds: float
    megabytes: float  # most at a time
    written: str


def mutated(content: bytes, random_of: random.Random) -> bytes:
    """Returns a content with one to a few places damaged: bytes, blocks, lengths."""
    damaged = bytearray(content)
    for _ in range(random_of.choice((1, 1, 2, 4, 16))):
        place, size = random_of.randrange(len(damaged)), random_of.choice((1, 2, 4, 8, 64, 512))
        match random_of.randrange(7):
            case 0:
                damaged[place] ^= 1 << random_of.randrange(8)
            case 1:
                damaged[place : place + size] = random_of.randbytes(min(size, len(damaged) - place))
            case 2:
                damaged[place : place + size] = random_of.choice((b"\0", b"\xff")) * min(size, len(damaged) - place)
            case 3:
                other = random_of.randrange(len(damaged))
                damaged[place : place + size] = damaged[other : other + size]
            case 4:
                damaged[place] = random_of.choice(b"0123456789ABCDEF")
            case 5:
                damaged[place:place] = random_of.randbytes(size)
            case _:
                del damaged[place : place + size]
    return bytes(damaged[: random_of.randrange(1, len(damaged))] if random_of.random() < 0.05 else damaged)


def outcome_of(words: Sequence[str], output: Path, longest: int = _LONGEST) -> Outcome:
    """Returns what comes of a command in a copy of this process.

    Args:
        words: Command and arguments.
        output: Takes what the command writes.
        longest: Processor time after which it is ended [s]; a command that only waits is ended after six times that.
    """
    begin = time.monotonic()
    child = os.fork()
    if child == 0:
        _run(words, output, longest)
    _, status, usage = os.wait4(child, 0)
    seconds = time.monotonic() - begin
    text = output.read_text(encoding="utf-8", errors="replace")
    return Outcome(os.waitstatus_to_exitcode(status), seconds, usage.ru_maxrss / 1024, text)


def _run(words: Sequence[str], output: Path, longest: int) -> None:
    """Ends this process with the exit status of a command, or by a signal."""
    status = _TRACEBACK
    try:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_PROF, longest)  # of a processor, which other programs do not lengthen
        signal.alarm(_WAITED * longest)
        descriptor = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        sys.stdout, sys.stderr = os.fdopen(1, "w", encoding="utf-8"), os.fdopen(2, "w", encoding="utf-8")
        try:
            status = canhaptic(words)
        except SystemExit as ended:
            status = int(ended.code or 0)
        sys.stdout.flush()
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    finally:
        os._exit(status)


def _energy_log(folder: Path) -> list[tuple[Path, Sequence[str]]]:
    path, log = folder / "run.h5", folder / "run.log"
    words = ["run", _CONFIG, "--duration", "0.3", "--pace", "free", "--log", str(path), "--bus-log", str(log)]
    made = outcome_of(words, folder / "output")
    assert made.status == 0, made.written
    whole = folder / "whole.h5"
    whole.write_bytes(path.read_bytes())
    page = str(folder / "table.csv")
    uses = ((), ("--json",), ("--recompute",), ("--compare", str(whole)), ("--check", "in >= 0"), ("--csv", page))
    return [(path, ("inspect", "FILE", *use)) for use in uses]


def _dictionary(folder: Path) -> list[tuple[Path, Sequence[str]]]:
    given = os.environ.get("CANHAPTIC_VENDOR_EDS")
    files = sorted([*(_ROOT / "eds").glob("*.eds"), *(Path(given).glob("*.[ed][dc][sf]") if given else ())])
    return [(file, ("check-eds", "FILE", *use)) for file in files for use in ((), ("--json",))]


def _bus_log(folder: Path) -> list[tuple[Path, Sequence[str]]]:
    files = sorted((_ROOT / "tests" / "recordings").glob("*.log"))
    uses = ((), ("--json",), ("--config", _CONFIG))
    return [(file, ("decode", "FILE", *use)) for file in files for use in uses]


def _recording(folder: Path) -> list[tuple[Path, Sequence[str]]]:
    _energy_log(folder)
    uses = ((), ("--json",), ("--account",), ("--from-sync",))
    return [(folder / "run.log", ("replay", "FILE", "--config", _CONFIG, *use)) for use in uses]


COMMANDS: Final[dict[str, Callable[[Path], list[tuple[Path, Sequence[str]]]]]] = {
    "inspect": _energy_log,
    "check-eds": _dictionary,
    "decode": _bus_log,
    "replay": _recording,
}


def outcomes(command: str, count: int, folder: Path) -> list[Outcome]:
    """Returns what comes of a command on mutants with fixed seeds; what went wrong is kept in `folder`.

    Args:
        command: One of `COMMANDS`.
        count: How many mutants.
        folder: Empty.
    """
    importlib.import_module(f"canhaptic.cli.{command.replace('-', '_')}")  # once, not in every copy
    uses, found = COMMANDS[command](folder), list[Outcome]()
    for number in range(count):
        source, words = uses[number % len(uses)]
        mutant = folder / f"mutant{number}{source.suffix}"
        mutant.write_bytes(mutated(source.read_bytes(), random.Random(f"{command} {number}")))
        given = [str(mutant) if word == "FILE" else word for word in words]
        found.append(outcome_of(given, folder / "output"))
        if found[-1].status in _WELL:
            mutant.unlink()
        else:
            sys.stderr.write(f"{' '.join(given)}: {found[-1].status}\n{found[-1].written[-2000:]}\n")
    return found


def main() -> int:
    """Measures every command and prints a line for each."""
    count, bad = int(sys.argv[1]) if len(sys.argv) > 1 else 200, 0
    for command in sys.argv[2:] or COMMANDS:
        found = outcomes(command, count, Path(tempfile.mkdtemp(prefix="mutated")))
        bad += sum(outcome.status not in _WELL for outcome in found)
        statuses = ", ".join(f"{n} x {status}" for status, n in sorted(Counter(o.status for o in found).items()))
        print(
            f"{command:<10} {count} mutants: longest {max(o.seconds for o in found):.2f} s, "
            f"most {max(o.megabytes for o in found):.0f} MB, exit status {statuses}"
        )
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())

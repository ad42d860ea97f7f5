"""How far does the ledger drift over 1e9 samples of noise? Slow: some minutes. `python -m tools.bench.ledger [N]`.

The sum of the package (`RunningSum`, one call per sample, as the ledger makes it) against the exact sum, which is
that of one block times the number of blocks, and against a plain running sum of the same samples.
"""

import itertools
import math
import random
import sys
from collections import deque
from functools import partial
from time import perf_counter

from canhaptic.control.balance import RunningSum, add
from tools.bench.report import Row, publish

SAMPLES = 1_000_000_000
BLOCK = 1_000_000
LIMIT = 1e-9  # [J]
DEVIATION = 1.0  # [J] of one sample: thousands of times what a hand does in a hold


def noise(seed: int = 11) -> list[float]:
    """Returns one block of samples [J]: as much in as out, and a little more in, so that the sum grows."""
    generator = random.Random(seed)
    return [generator.gauss(1e-4, DEVIATION) for _ in range(BLOCK)]


def main(samples: int = SAMPLES) -> None:
    """Adds the samples one by one and publishes the drift."""
    block, blocks = noise(), max(1, samples // BLOCK)
    total = RunningSum()
    start = perf_counter()
    for _ in range(blocks):
        deque(map(partial(add, total), block), maxlen=0)  # consumed in C: the loop costs less than the call
    duration = perf_counter() - start
    plain = 0.0
    for _ in range(blocks):
        plain = deque(itertools.accumulate(block, initial=plain), maxlen=1)[0]
    exact = blocks * math.fsum(block)
    drift, naive = abs(total.value - exact), abs(plain - exact)
    samples = blocks * BLOCK
    rows = [
        Row(
            f"drift after {samples:g} samples", drift, "J", "plain sum", naive, target=f"< {LIMIT:g}", met=drift < LIMIT
        ),
        Row("sum", exact, "J"),
        Row("samples", float(samples), ""),
        Row("time", duration, "s"),
        Row("time of a sample", 1e9 * duration / samples, "ns"),
    ]
    publish("ledger", rows, ["canhaptic"])


if __name__ == "__main__":
    main(int(float(sys.argv[1])) if len(sys.argv) > 1 else SAMPLES)

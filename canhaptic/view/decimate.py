"""Min/max decimation: long records drawn in a few thousand points without losing a one-sample spike.

Striding would lose it. Every bucket of samples is drawn as its first extreme and its second, in their order.
"""

import numpy as np
from numpy.typing import NDArray


def decimate(values: NDArray[np.generic], buckets: int) -> NDArray[np.intp]:
    """Return the indices of samples to draw: the least and the greatest of every bucket, in order, both ends kept.

    Args:
        values: Shape (n,); NaN is drawn where it is.
        buckets: About half the number of points wanted.

    Returns:
        Ascending indices; all of them when there are no more than two per bucket.
    """
    length = len(values)
    if length <= 2 * buckets:
        return np.arange(length)
    size = -(-length // buckets)
    whole = length // size * size
    blocks = values[:whole].reshape(-1, size)
    starts = np.arange(0, whole, size)
    indices = [starts + blocks.argmin(axis=1), starts + blocks.argmax(axis=1), np.array([0, length - 1])]
    if whole < length:
        rest = values[whole:]
        indices.append(whole + np.array([rest.argmin(), rest.argmax()]))
    return np.unique(np.concatenate(indices))

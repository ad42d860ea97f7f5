"""Studies of scenes: variations of a scene are cases, each case gives a row of values, and rows become tables.

A row is flat, and complete by itself: it has the keys of its case, `status`, `remark`, and figures by the names of
`quantities.FIGURES`, such as `position_error.rms`. A list of rows is a table of `pandas.DataFrame`.
"""

from collections.abc import Iterator, Mapping
from typing import Any

Row = dict[str, Any]
"""Result of one case: values by name, as `--json` prints them."""


def flat(values: Mapping[str, Any]) -> Row:
    """Return nested values as a row: `{"margin": {"value": -1.0, "time": 2.0}}` as `margin` and `margin.time`."""
    return dict(_flattened(values))


def _flattened(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        path = (prefix + name).removesuffix(".value")
        if isinstance(value, Mapping):
            yield from _flattened(value, f"{path}.")
        else:
            yield path, value

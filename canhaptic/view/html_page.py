"""Pages that any browser opens without a network, drawn by Bokeh: where it is asked for, and how a page is written."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canhaptic.errors import InputError
from canhaptic.extras import install_hint
from canhaptic.host.output_file import replacing

if TYPE_CHECKING:
    from bokeh.models import LayoutDOM, Range1d

_EDGE: Final = 0.1
"""Decades of a logarithmic range on either side of its whole ones."""


def require_bokeh() -> None:
    """Imports Bokeh.

    Raises:
        InputError: It is not installed.
    """
    try:
        import bokeh.plotting  # noqa: F401 - what every page is drawn with
    except ImportError as error:
        raise InputError(f"an HTML page needs Bokeh; install it with: {install_hint('report')}") from error


def decades(values: Sequence[float]) -> "Range1d":
    """Returns a logarithmic range of more than two decades: its ticks are powers of ten, which never overlap.

    Args:
        values: Positive; not empty.
    """
    from bokeh.models import Range1d

    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    return Range1d(10.0 ** (low - _EDGE), 10.0 ** (max(high, low + 2) + _EDGE))


def write_page(content: "LayoutDOM", title: str, path: Path) -> None:
    """Writes a layout of Bokeh as one self-contained page.

    Raises:
        InputError: The page cannot be written.
    """
    from bokeh.embed import file_html
    from bokeh.resources import INLINE

    text = file_html(content, INLINE, title=title)
    try:
        with replacing(path) as page:
            page.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: the page cannot be written ({error.strerror})") from error

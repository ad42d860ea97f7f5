"""Pictures, pages and tables of the studies."""

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canhaptic.view.picture_style import drawing, save_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKS: Final = "osv^<>DPX*hpd"
WHITE, BLACK = "#fffffe", "#000001"
"""Ink on coloured cells; no greys, which a dark page would turn over."""
_LETTERS: Final = 11.5
"""Letters of a caption per inch of the picture."""


@contextmanager
def sheet(path: str | Path, width: float, height: float, caption: str = "") -> "Iterator[Figure]":
    """Yield an empty picture, which is written at the end of the block; the suffix of the file gives the format.

    Args:
        path: File of the picture.
        width: Width [inch].
        height: Height [inch].
        caption: Text above the panels; long lines are wrapped.

    Raises:
        InputError: matplotlib is not installed, or the file cannot be written.
    """
    with drawing() as figure_type:
        figure = figure_type(figsize=(width, height), dpi=110, layout="constrained")
        yield figure
        lines = [textwrap.fill(line, round(_LETTERS * width), break_long_words=False) for line in caption.splitlines()]
        if lines:
            figure.suptitle("\n".join(lines), x=0.01, ha="left", fontsize=9.5, color="#404040")
        save_picture(figure, path)

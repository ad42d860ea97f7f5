"""Style of every picture: colours, import of matplotlib, and writing of the file.

The colours are those of Okabe and Ito, which colour-blind readers distinguish, and two greys. Lines also differ in
width and style.
"""

import os
from collections.abc import Iterator
from colorsys import hls_to_rgb
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from canhaptic.errors import InputError
from canhaptic.extras import install_hint
from canhaptic.files import read_regular, replacing
from canhaptic.quantities import ALARM as ALARM
from canhaptic.quantities import BLUE as BLUE
from canhaptic.quantities import GREEN as GREEN
from canhaptic.quantities import GREY as GREY
from canhaptic.quantities import ORANGE as ORANGE
from canhaptic.quantities import PALE as PALE
from canhaptic.quantities import PURPLE as PURPLE
from canhaptic.quantities import SKY as SKY
from canhaptic.quantities import VERMILION as VERMILION

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_OVERLAID: Final = ("black", PURPLE, SKY, PALE)


def overlaid(count: int) -> list[str]:
    """Return a colour of its own for each of some overlaid runs."""
    hues = (number / max(1, count - len(_OVERLAID)) for number in range(count - len(_OVERLAID)))
    further = ("#" + "".join(f"{round(255 * part):02x}" for part in hls_to_rgb(hue, 0.42, 0.7)) for hue in hues)
    return [*_OVERLAID, *further][:count]


STYLE: Final[Any] = {
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#808080",
    "axes.grid": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "svg.hashsalt": "canhaptic",
    "text.parse_math": False,  # a name may have dollars
}
"""Settings for `matplotlib.rc_context`."""
_SMALL: Final[Any] = {"font.size": 7.0, "axes.titlesize": 7.0, "legend.fontsize": 6.0, "axes.linewidth": 0.6}
_AS_TEXT: Final[Any] = {"svg.fonttype": "none", "pdf.fonttype": 42}
"""Letters of a figure stay letters in its file, which a reader can search and an editor can change."""
_FOREIGN: Final = "matplotlibrc"  # of the current folder, which matplotlib reads before any other
_LARGEST: Final = 1_000_000  # [bytes]
_PREFIXES: Final = ((1.0, ""), (1e-3, "m"), (1e-6, "u"), (1e-9, "n"), (1e-12, "p"))


def require_matplotlib() -> None:
    """Import matplotlib.

    Raises:
        InputError: matplotlib is not installed, or cannot be loaded.
    """
    try:
        if not os.path.isdir(_FOREIGN):
            with suppress(FileNotFoundError):
                # A pipe or a device is refused; matplotlib would read it without end.
                read_regular(_FOREIGN, _LARGEST)
        import matplotlib.figure  # noqa: F401 - raises where it is not installed
    except ImportError as error:
        raise InputError(f"a picture needs matplotlib; install it with: {install_hint('plot')}") from error
    except (OSError, ValueError) as error:
        raise InputError(
            f"matplotlib cannot be loaded ({error}); remove or mend the file matplotlibrc in this folder"
        ) from error


@contextmanager
def drawing(*, is_small: bool = False) -> "Iterator[type[Figure]]":
    """Yield matplotlib's `Figure` class, which needs no display; within the block the package's style applies.

    Args:
        is_small: Whether letters are as small as in a paper.

    Raises:
        InputError: matplotlib is not installed.
    """
    require_matplotlib()
    from matplotlib import rc_context, rcdefaults, rcParams
    from matplotlib.figure import Figure

    with rc_context():
        rcdefaults()  # what a `matplotlibrc` of the current folder or of the user says is not for these
        rcParams.update({**STYLE, **(_SMALL if is_small else {})})

        class TextFigure(Figure):
            def savefig(self, *words: Any, **named: Any) -> None:
                with rc_context(_AS_TEXT):
                    super().savefig(*words, **named)

        yield TextFigure


def save_picture(figure: "Figure", path: str | Path) -> None:
    """Write a figure into a file; its suffix gives the format (.png, .svg, .pdf).

    Raises:
        InputError: The file cannot be written.
    """
    _write_powers_plainly(figure)
    try:
        with drawing(), replacing(Path(path)) as picture:
            figure.savefig(picture)
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: the picture cannot be written ({error}); name another file") from error


def _write_powers_plainly(figure: "Figure") -> None:
    """Format the ticks of logarithmic axes as plain text: the style turns mathematical text off."""
    from matplotlib.ticker import FuncFormatter, LogFormatter, LogFormatterMathtext

    for axis in (axis for panel in figure.axes for axis in (panel.xaxis, panel.yaxis)):
        if isinstance(axis.get_major_formatter(), LogFormatterMathtext):
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        if isinstance(axis.get_minor_formatter(), LogFormatterMathtext):
            axis.set_minor_formatter(LogFormatter(minor_thresholds=(1.0, 0.4)))


def scale_of(largest: float) -> tuple[float, str]:
    """Return the scale and SI prefix of an axis with which its largest value is between 1 and 1000."""
    return next(((scale, prefix) for scale, prefix in _PREFIXES if largest >= scale), _PREFIXES[0])

"""Picture of two logs of one link: what came in at both motors, their least sum, what was under way and given up."""

from pathlib import Path
from typing import Final

import numpy as np

from canhaptic.audit.two_logs import course
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.view.picture_style import ALARM, BLUE, GREEN, GREY, ORANGE, drawing, save_picture, scale_of

_SIZE: Final = (9.0, 6.5)  # [inch]


def draw_pair(first: EnergyLog, second: EnergyLog, path: str | Path) -> None:
    """Draw two logs of one link into a file, over the SYNCs of the first; its suffix gives the format.

    Args:
        first: An open energy log with a far side.
        second: Energy log of the other rig.
        path: File to write.

    Raises:
        InputError: The logs have no session in common, matplotlib is not installed, or the file cannot be written.
    """
    known = course(first, second)
    one, other = known.energies
    largest = max(float(np.nanmax(np.abs(values), initial=0.0)) for values in (one, other, known.under_way))
    scale, prefix = scale_of(largest)
    with drawing() as figure_type:
        figure = figure_type(figsize=_SIZE, layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        above.plot(known.time, one / scale, color=BLUE, label=f"came in at {first.path.name}")
        above.plot(known.time, other / scale, color=ORANGE, linestyle="--", label=f"came in at {second.path.name}")
        above.plot(known.time, known.least / scale, color=GREEN, linewidth=2.0, label="least sum by the packets")
        above.axhline(0.0, color=ALARM, linewidth=0.8)
        below.plot(known.time, known.under_way / scale, color=BLUE, label="under way, both directions")
        below.plot(known.time, known.given_up / scale, color=GREY, linestyle="--", label="given up by both")
        below.set_xlabel(f"time of {first.path.name} [s]")
        for panel in (above, below):
            panel.set_ylabel(f"energy [{prefix}J]")
            panel.legend(loc="upper left")
    save_picture(figure, path)

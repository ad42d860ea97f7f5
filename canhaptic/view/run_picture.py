"""One picture of a run: path, position and wall, torque, energy in against dissipated, surplus; a column per account.

An axis in a group has no column: its position and torque are drawn in that of the group. Panels that would show nothing
but zeros are left out.

matplotlib is imported when a picture is drawn, not before.
"""

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canhaptic.audit.extent import rows_between, rows_to_draw
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.view.palette import OVERLAID
from canhaptic.view.picture_style import drawing, save_picture
from canhaptic.view.port_picture import PortPicture
from canhaptic.view.si import si

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_HEIGHTS: Final = {"path": 5.0, "position": 3.0, "velocity": 2.0, "torque": 3.0, "energy": 4.0, "surplus": 2.0}
"""Heights of the panels, in units of `_INCH`."""
_INCH: Final = 0.75  # per unit of height


def draw_energy(
    log: EnergyLog,
    path: str | Path,
    start: float | None = None,
    stop: float | None = None,
    others: Sequence[EnergyLog] = (),
) -> None:
    """Draw a run into a file; its suffix says how (.png, .svg, .pdf).

    The wall is drawn where the log's attributes `NAME.wall_position` and `NAME.wall_side` say so.

    Args:
        log: An open energy log.
        path: The picture.
        start: Time of the first SYNC to draw [s]; from the beginning by default.
        stop: Time of the first SYNC not to draw [s]; to the end by default.
        others: Further runs, drawn over the first in thin dashed lines where they have the same ports.

    Raises:
        InputError: The log holds no cycle there, matplotlib is not installed, or the file cannot be written.
    """
    with drawing():
        save_picture(energy_figure(log, start, stop, others), path)


def energy_figure(
    log: EnergyLog,
    start: float | None = None,
    stop: float | None = None,
    others: Sequence[EnergyLog] = (),
    labels: Sequence[str] = (),
) -> "Figure":
    """Return the matplotlib figure of a run; the arguments are those of `draw_energy`.

    Args:
        log: An open energy log.
        start: As there.
        stop: As there.
        others: As there.
        labels: One for each of them; by default the names of their files.
    """
    names = list(labels) or [other.path.name for other in others]
    rows = rows_to_draw(log, start, stop)
    with drawing() as figure_type:
        pictures = {name: PortPicture(log, name, rows) for name in log.ports if name not in log.group_of}
        figure, columns = _layout(figure_type, pictures)
        for name, picture in pictures.items():
            picture.draw(columns[name])
            for other, label, colour in zip(others, names, cycle(OVERLAID)):
                if name in other.ports and other.rows:
                    overlay = PortPicture(other, name, rows_between(other, start, stop))
                    overlay.draw_over(columns[name], picture.scales, label, colour)
            list(columns[name].values())[-1].set_xlabel("time [s]" + picture.faults())
        figure.suptitle(_caption(log), x=0.995, ha="right", fontsize=8.0, color="#707070")
    return figure


def _layout(
    figure_type: "type[Figure]", pictures: Mapping[str, PortPicture]
) -> "tuple[Figure, dict[str, dict[str, Axes]]]":
    """Return an empty figure, and of each port its panels by name, top to bottom, all but paths over one time axis."""
    wanted = {name: picture.draws() for name, picture in pictures.items()}
    rows = [row for row in _HEIGHTS if any(row in names for names in wanted.values())]
    heights = [_HEIGHTS[row] for row in rows]
    figure = figure_type(figsize=(2.0 + 6.5 * len(pictures), _INCH * sum(heights)), dpi=120)
    figure.set_layout_engine("constrained", hspace=0.04, h_pad=0.06)
    grid = figure.add_gridspec(len(rows), len(pictures), height_ratios=heights)
    columns: dict[str, dict[str, Axes]] = {}
    first = None
    for number, (name, names) in enumerate(wanted.items()):
        columns[name] = {}
        for row in names:
            over_time = row != "path"
            axes = figure.add_subplot(grid[rows.index(row), number], sharex=first if over_time else None)
            axes.tick_params(labelbottom=row in ("path", names[-1]))
            first = axes if over_time and first is None else first
            columns[name][row] = axes
    return figure, columns


def _caption(log: EnergyLog) -> str:
    parts = [log.path.name, f"{log.rows} cycles at {si(1.0 / log.sample_time, 'Hz', 3)}", log.status]
    if "config_hash" in log.attributes:
        parts.insert(1, f"configuration {str(log.attributes['config_hash'])[:12]}")
    return "   ".join(parts)

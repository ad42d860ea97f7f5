"""Makes Figures 4, 5, 7, 8 and 9 of the paper through the whole CAN path: `python -m tools.paper_figures`.

Pictures go to docs/images, their figures to docs/results/paper_figures.json with those of the traps (`paper_traps`).
Left in every picture is the paper's own loop, in which a torque acts at the SYNC that computed it; right the same scene
with that torque acting one sample later, as a CANopen drive with a synchronous RPDO does.
"""

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from canhaptic.view.picture_style import BLUE, GREEN, PALE, STYLE, VERMILION
from tools.bench.report import RESULTS, write_result
from tools.paper_runs import LATE, ROOT, Record, figures_of, record
from tools.paper_traps import traps

RESULT: Final = RESULTS / "paper_figures.json"
IMAGES: Final = ROOT / "docs" / "images"
PACKAGES: Final = ("canhaptic", "numpy")


@dataclass(frozen=True, slots=True)
class PaperFigure:
    """One figure: its scene, the runs that are counted, and the two of them that are drawn."""

    title: str
    config: str
    runs: Mapping[str, tuple[str, ...]]  # name -> overrides
    drawn: tuple[tuple[str, str], ...]  # (name, heading) of each column
    energy: bool = False  # energies instead of the contact response

    @property
    def picture(self) -> str:
        """Name of the file."""
        return f"paper_{self.config.removeprefix('paper_').partition('_')[0]}.png"


_BOTH: Final = {"no_delay": (), "one_sample_late": LATE}
_PLAIN: Final = "passivity={algorithm: unprotected}"
_WITH_PLAIN: Final = {**_BOTH, "unprotected": (_PLAIN,), "one_sample_late_unprotected": (*LATE, _PLAIN)}
_STIFFER: Final = "environment.stiffness=500 N/m"
_COLUMNS: Final = (("no_delay", "without delay: the paper's loop"), ("one_sample_late", "one sample late"))
_CAPPED: Final = "one_sample_late_mass_known"
_GUARDED: Final = (
    "passivity={algorithm: guarded, moving_mass: 0.2 kg, device_damping_bound: 0.2 N*s/m, hand_force: 0 N, "
    "hand_push: 20 N}"
)
FIGURES: Final[dict[str, PaperFigure]] = {
    "fig4": PaperFigure("Fig. 4: the original algorithm at 40 Hz", "paper_fig4_40hz.yaml", _WITH_PLAIN, _COLUMNS),
    "fig5": PaperFigure("Fig. 5: the original algorithm at 100 Hz", "paper_fig5_100hz.yaml", _WITH_PLAIN, _COLUMNS),
    "fig7": PaperFigure(
        "Fig. 7: the paper's algorithm at 40 Hz",
        "paper_fig7_40hz.yaml",
        {
            **_WITH_PLAIN,
            _CAPPED: (*LATE, "passivity.moving_mass=0.25 kg"),
            "guarded": (_GUARDED,),
            "one_sample_late_guarded": (*LATE, _GUARDED),
            "stiffer": (_STIFFER,),
            "stiffer_unprotected": (_STIFFER, _PLAIN),
            "stiffer_guarded": (_STIFFER, _GUARDED),
        },
        (_COLUMNS[0], (_CAPPED, "one sample late, damping capped for the mass")),
    ),
    "fig8": PaperFigure("Fig. 8: the paper's algorithm at 100 Hz", "paper_fig8_100hz.yaml", _WITH_PLAIN, _COLUMNS),
    "fig9": PaperFigure(
        "Fig. 9: energy exchanged and dissipated at 100 Hz", "paper_fig9_100hz.yaml", _BOTH, _COLUMNS, energy=True
    ),
}


def run_all(name: str) -> dict[str, Record]:
    """Returns every run of one figure."""
    figure = FIGURES[name]
    return {label: record(figure.config, overrides) for label, overrides in figure.runs.items()}


def draw(name: str, runs: Mapping[str, Record], path: Path) -> None:
    """Draws one figure of the paper into a PNG.

    Args:
        name: Of `FIGURES`.
        runs: Of `run_all`.
        path: The picture.
    """
    figure = FIGURES[name]
    import matplotlib as mpl  # a second, for who asks for a name of this module alone
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        sheet = Figure(figsize=(11.0, 5.0), dpi=100, layout="constrained")
        panels: Any = sheet.subplots(2, len(figure.drawn), sharex=True, sharey="row", height_ratios=(3, 2))
        for column, (label, heading) in enumerate(figure.drawn):
            taken = runs[label]
            (_draw_energies if figure.energy else _draw_contact)(panels[:, column], taken)
            panels[0, column].set_title(heading)
            panels[1, column].set_xlabel("time [s]")
            panels[0, column].set_xlim(0.0, taken.time[-1] + taken.time[1])
        handles, labels = panels[0, 0].get_legend_handles_labels()
        more, further = panels[1, 0].get_legend_handles_labels()
        known = dict(zip([*labels, *further], [*handles, *more], strict=True))
        sheet.align_ylabels(panels[:, 0])
        sheet.suptitle(figure.title, x=0.01, ha="left", fontweight="bold", fontsize=11.0)
        sheet.legend(list(known.values()), list(known), loc="upper right", ncols=len(known))
        sheet.savefig(path, metadata={"Software": None}, pil_kwargs={"optimize": True})


def _draw_contact(panels: Any, taken: Record) -> None:
    """Position and force over time: the contact response."""
    position, force = panels
    of = taken.reference
    reach = 1.1e3 * np.abs(taken.position).max()
    position.axhspan(-reach, 1e3 * taken.wall, color=PALE, alpha=0.12, linewidth=0)
    position.plot(taken.time, 1e3 * of.position, color=PALE, linewidth=2.4, alpha=0.6, label="continuous wall")
    position.plot(taken.time, 1e3 * taken.position, color=BLUE, linewidth=1.2, label="sampled wall")
    position.set_ylim(-reach, reach)
    position.set_ylabel("position [mm]\n(grey: inside the wall)" if _is_left(position) else "")
    force.plot(of.fine_time, of.fine_torque, color=PALE, linewidth=2.4, alpha=0.6)
    force.plot(taken.time, taken.torque, color=BLUE, linewidth=1.0, drawstyle="steps-pre")
    stuck = taken.sticky
    if stuck.any():
        force.plot(taken.time[stuck], taken.torque[stuck], "o", color=VERMILION, markersize=3.5, label="sticky hold")
    force.set_ylabel("force [N]" if _is_left(force) else "")


def _draw_energies(panels: Any, taken: Record) -> None:
    """Sums of interaction and dissipated energy, and what eq. 4 asks to be positive: the first less the second."""
    energy, margin = panels
    exchanged, dissipated = np.cumsum(taken.h_i), np.cumsum(taken.h_r)
    energy.plot(taken.time, 1e3 * exchanged, color=BLUE, linewidth=1.4, label="exchanged, sum of h_i")
    energy.plot(
        taken.time, 1e3 * dissipated, color=VERMILION, linewidth=1.4, linestyle=(0, (4, 1.5)),
        label="dissipated, sum of h_r",
    )  # fmt: skip
    energy.set_ylabel("energy [mJ]" if _is_left(energy) else "")
    margin.axhline(0.0, color=PALE, linewidth=0.8)
    margin.plot(taken.time, 1e3 * (exchanged - dissipated), color=GREEN, linewidth=1.2, label="margin of eq. 4")
    margin.set_ylabel("margin [mJ]" if _is_left(margin) else "")


def _is_left(axes: Any) -> bool:
    return bool(axes.get_subplotspec().is_first_col())


def main() -> int:
    """Makes everything; returns 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=Path, default=IMAGES, help="folder of the pictures")
    parser.add_argument("--result", type=Path, default=RESULT, help="JSON file of the figures")
    arguments = parser.parse_args()
    found: dict[str, Any] = {}
    for name, figure in FIGURES.items():
        runs = run_all(name)
        draw(name, runs, arguments.images / figure.picture)
        found[name] = {label: figures_of(taken) for label, taken in runs.items()}
        print(arguments.images / figure.picture)
    found["traps"] = traps()
    write_result(arguments.result, PACKAGES, found)
    print(arguments.result)
    return 0


if __name__ == "__main__":
    sys.exit(main())

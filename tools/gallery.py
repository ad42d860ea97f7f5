"""Makes docs/gallery.md and its pictures: `python -m tools.gallery`, `--only NAME` for one of them, `--page` for none.

Each picture is made by the very command that the page prints with it, in a process of its own, from a folder that
holds the shipped `configs/` and `eds/` and nothing else. Then its colours are reduced to a palette.
"""

import argparse
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from PIL import Image

from canhaptic.errors import InputError

ROOT: Final = Path(__file__).resolve().parents[1]
PAGE: Final = ROOT / "docs" / "gallery.md"
IMAGES: Final = ROOT / "docs" / "images" / "gallery"
LARGEST: Final = 170_000
"""Bytes of one picture."""
_COLOURS: Final = (256, 128, 64)
_COMMAND: Final = (sys.executable, "-m", "canhaptic")
_SIX: Final = "guarded,unprotected,a_priori_dissipation,internal_dissipation,passivity_observer,energy_bounding"
_INTRODUCTION: Final = """\
# Gallery

For everybody who asks what it can do, and how a picture is made.

Each picture was made by the command below it. The page and its pictures are made by `python -m tools.gallery`, and a
test runs every command. Grey in comparisons is the continuous wall under the same hand.

Where to go next: [touch a wall](tutorials/touch_a_wall.md), and the [commands](commands.md).
"""


@dataclass(frozen=True, slots=True)
class Entry:
    """One picture, and how it is made."""

    title: str
    sentence: str
    commands: tuple[str, ...]  # the last one writes the picture
    brief: tuple[str, ...] = ("--duration 0.3",)  # what makes each command short where only its success is asked

    @property
    def picture(self) -> str:
        """Name of the file, from the last command."""
        words = shlex.split(self.commands[-1])
        return words[words.index("--png") + 1]


GALLERY: Final[tuple[Entry, ...]] = (
    Entry(
        "The paper's wall",
        "A simulated hand dips into a sampled wall over a virtual CAN bus: position, force, energy in and dissipated.",
        ("canhaptic run configs/demo.yaml --png demo.png",),
    ),
    Entry(
        "The same, with frames lost",
        "One frame in fifty never arrives, the others come up to 200 us late; the account assumes the worst case.",
        (
            "canhaptic run configs/demo.yaml --duration 4 "
            "--set simulation.bus='{drop: 0.02, jitter: 200 us}' --png lossy.png",
        ),
    ),
    Entry(
        "Six algorithms at a stiff wall",
        "1e5 N/m at 1 kHz, far beyond what the device's own damping could hold: the plain wall rattles.",
        (f"canhaptic compare configs/hard/stiff_wall.yaml --algorithms {_SIX} --png stiff_wall.png",),
    ),
    Entry(
        "Between two walls",
        "A slot 10 mm wide, one sample late: what one wall gives out, the other takes in and amplifies.",
        (f"canhaptic compare configs/hard/slot.yaml --algorithms {_SIX} --png slot.png",),
    ),
    Entry(
        "A limit cycle, with and without",
        "Twice Colgate's limit under a constant push: the plain wall never comes to rest.",
        (f"canhaptic compare configs/hard/limit_cycle.yaml --algorithms {_SIX} --png limit_cycle.png",),
    ),
    Entry(
        "A coarse encoder",
        "Counts of 0.1 mm: a damper on raw differences turns every count into a kick.",
        (f"canhaptic compare configs/hard/coarse_encoder.yaml --algorithms {_SIX} --png coarse_encoder.png",),
    ),
    Entry(
        "Tremor on the surface",
        "Eight seconds of tremor and two of rest: the paper's state creeps away from the wall, `guarded` does not.",
        (f"canhaptic compare configs/hard/tremor_on_the_surface.yaml --algorithms {_SIX} --png tremor.png",),
    ),
    Entry(
        "Stick-slip",
        "A weak hand drags the handle over dry friction that falls with speed, in and out of a soft wall.",
        ("canhaptic run configs/accuracy/stick_slip.yaml --duration 3 --png stick_slip.png",),
    ),
    Entry(
        "A rig on two buses",
        "Four axes, two CAN buses, one SYNC deadline; every axis has its own hand and its own account.",
        ("canhaptic run configs/two_buses.yaml --png two_buses.png",),
    ),
    Entry(
        "Two handles",
        "Two hands feel each other through one network over a bus that loses one frame in a hundred.",
        ("canhaptic run configs/two_handles.yaml --duration 10 --png two_handles.png",),
    ),
    Entry(
        "A room on an X-Y stage",
        "Two axes share one account: what comes in by one may go out by the other.",
        ("canhaptic run configs/xy_box.yaml --png xy_box.png",),
    ),
    Entry(
        "A disc felt with a five-bar",
        "Two motors, closed kinematics; the account is kept in the angles, where the torque is constant in a hold.",
        ("canhaptic run configs/five_bar_sphere.yaml --png five_bar_sphere.png",),
    ),
    Entry(
        "What accuracy costs",
        "Error against time and against evaluations, method by method, and what each part of the loop adds to it.",
        ("canhaptic accuracy configs/accuracy/stick_slip.yaml --png accuracy.png",),
        ("--duration 0.1 --budget 1",),
    ),
    Entry(
        "A map of walls and rates",
        "96 walls and rates under two algorithms: the stiffest wall, what is missing in (4), what is left of stiffness "
        "and damping. No bus could carry the highest rates.",
        (
            "canhaptic sweep configs/demo.yaml --vary environment.stiffness=100:1e5:log:16 "
            "--vary bus.rate=100:3200:log:6 --controllers unprotected,guarded --duration 4 --beyond-bus --out walls",
            "canhaptic sweep --map walls --png map.png",
        ),
        ("--duration 0.1", ""),
    ),
    Entry(
        "The same map with stiction",
        "Dry friction of 0.3 N in motion and 0.5 N at rest in the guide, and the same encoder of 1 um. The friction "
        "damps the walls that rattled: at most rates both algorithms render stiffer ones.",
        (
            "canhaptic sweep configs/demo.yaml "
            "--set simulation.effects='[{type: coulomb_friction, kinetic: 0.3 N, static: 0.5 N}]' "
            "--vary environment.stiffness=100:1e5:log:16 --vary bus.rate=100:3200:log:6 "
            "--controllers unprotected,guarded --duration 4 --beyond-bus --out walls_stiction",
            "canhaptic sweep --map walls_stiction --png map_stiction.png",
        ),
        ("--duration 0.1", ""),
    ),
)


def make(entry: Entry, folder: Path, brief: bool = False) -> Path:
    """Runs the commands of an entry in a folder and returns its picture.

    Args:
        entry: Of `GALLERY`.
        folder: Where `configs/` and `eds/` are, and where the picture goes.
        brief: Whether to shorten the runs.

    Raises:
        InputError: A command failed.
    """
    for command, shorter in zip(entry.commands, entry.brief, strict=True):
        words = shlex.split(f"{command} {shorter}" if brief else command)
        ended = subprocess.run([*_COMMAND, *words[1:]], cwd=folder, capture_output=True, text=True, check=False)
        if ended.returncode != 0:
            raise InputError(f"{shlex.join(words)}: exit status {ended.returncode}: {ended.stderr.strip()[-400:]}")
    return folder / entry.picture


def prepare(folder: Path) -> None:
    """Puts the shipped scenes and dictionaries into a folder."""
    for name in ("configs", "eds"):
        (folder / name).symlink_to(ROOT / name, target_is_directory=True)


def reduce(picture: Path, into: Path) -> None:
    """Writes a picture with a palette of as many colours as keep it small.

    Raises:
        InputError: It is too large with the fewest.
    """
    image = Image.open(picture).convert("RGB")
    for colours in _COLOURS:
        reduced = image.quantize(colours, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
        reduced.save(into, optimize=True)
        if into.stat().st_size <= LARGEST:
            return
    raise InputError(f"{into.name}: {into.stat().st_size} bytes, expected <= {LARGEST}; draw less, or shorten it")


def page() -> str:
    """Returns the text of the page."""
    sections = [
        f"## {entry.title}\n\n{entry.sentence}\n\n![{entry.title}](images/gallery/{entry.picture})\n\n"
        f"```bash\n{_broken(entry.commands)}\n```\n"
        for entry in GALLERY
    ]
    return "\n".join([_INTRODUCTION, *sections])


def _broken(commands: Sequence[str]) -> str:
    text = "\n".join(commands)
    for option in (" --vary", " --controllers", " --set simulation.effects"):
        text = text.replace(option, f" \\\n   {option}")
    return text


def main() -> int:
    """Makes the gallery; returns 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--only", action="append", choices=[Path(entry.picture).stem for entry in GALLERY])
    chosen.add_argument("--page", action="store_true", help="write the page, leave the pictures")
    arguments = parser.parse_args()
    IMAGES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        prepare(Path(name))
        for entry in () if arguments.page else GALLERY:
            if arguments.only is None or Path(entry.picture).stem in arguments.only:
                reduce(make(entry, Path(name)), IMAGES / entry.picture)
                print(f"{IMAGES / entry.picture}: {(IMAGES / entry.picture).stat().st_size} bytes")
    PAGE.write_text(page(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

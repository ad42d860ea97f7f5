"""Makes docs/accuracy: tables and pictures of what accuracy costs in five scenes. `--only NAME` makes one of them."""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any, Final

from canhaptic.lab.render.accuracy_picture import draw_accuracy
from canhaptic.lab.studies.accuracy.accuracy_table import advice, advice_lines, length, markdown
from canhaptic.lab.studies.accuracy.study import AccuracyStudy, chosen_part
from canhaptic.scene.load import load_scene
from tools.bench.report import write_result

ROOT: Final = Path(__file__).resolve().parents[1]
SCENES: Final = ("paper_wall", "stiff_stop", "stick_slip", "delayed_bus", "coarse_encoder")
BUDGET: Final = 12.0  # [s], compiled plants included
PACKAGES: Final = ("canhaptic", "numpy", "scipy", "mujoco")


def make(name: str, folder: Path) -> None:
    """Writes NAME.json, NAME.md and NAME.png."""
    scene = load_scene(Path("configs") / "accuracy" / f"{name}.yaml")
    _write(name, AccuracyStudy(scene, budget=BUDGET).run(), folder)


def redraw(name: str, folder: Path) -> None:
    """Writes advice, tables and picture anew from what was measured before."""
    result = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    scene = load_scene(Path("configs") / "accuracy" / f"{name}.yaml")
    result["now"] = chosen_part(scene, None).now()
    result["advice"] = advice(result["plant"], result["advice"]["effects"], result["tolerance"], result["orders"])
    _write(name, result, folder)


def _write(name: str, result: dict[str, Any], folder: Path) -> None:
    write_result(folder / f"{name}.json", PACKAGES, result)
    draw_accuracy(result, folder / f"{name}.png")
    title = name.replace("_", " ").capitalize()
    comment = _comment(ROOT / "configs" / "accuracy" / f"{name}.yaml")
    text = f"# {title}\n\n{comment}\n\n![{title}]({name}.png)\n\n{markdown(result)}"
    (folder / f"{name}.md").write_text(text, encoding="utf-8")
    print("\n".join([name, *(f"  {line}" for line in advice_lines(result))]))


def write_index(folder: Path) -> None:
    """Writes README.md with the advice for every scene that has been made."""
    lines = [
        "# What accuracy costs in time: five scenes", "",
        "Made by `python -m tools.accuracy_gallery`. Evaluations are the same on every machine; times are the least of",
        "interleaved repeats on the machine named in each JSON file. The line in the third column can be pasted into a",
        "scene: it needs the fewest evaluations of all settings that keep the tolerance, as do all finer ones.",
        "`cheaper yet` is a textbook method that needs fewer still, but that a scene cannot name. `canhaptic accuracy",
        "CONFIG` does the same for your scene.",
        "",
        "| scene | tolerance | cheapest setting | error | evaluations a period | us a period | cheaper yet |",
        "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for name in SCENES:
        path = folder / f"{name}.json"
        if not path.exists():
            continue
        result = json.loads(path.read_text(encoding="utf-8"))
        given, unit = result["advice"], result["unit"]
        chosen = given["chosen"]
        other = [f"{row['method']}, {row['setting']}" for row in given["cheaper_elsewhere"][:1]]
        lines.append(
            f"| [{name.replace('_', ' ')}]({name}.md) | {length(given['tolerance'], unit)} | "
            f"`{given['line']}` | "
            f"{length(chosen['position_error'], unit)} | {chosen['evaluations_per_period']:.3g} | "
            f"{chosen['us_per_period']:.3g} | {' '.join(other) or '-'} |"
        )
    (folder / "README.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _comment(path: Path) -> str:
    """Returns what the scene says of itself: its leading comment without the command."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        text = line.removeprefix("#").strip()
        if not text.startswith("canhaptic "):
            lines.append(text)
    return " ".join(line for line in lines if line)


def main() -> int:
    """Returns 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=SCENES)
    parser.add_argument("--redraw", action="store_true", help="from the JSON files, without measuring")
    parser.add_argument("--folder", type=lambda text: Path(text).absolute(), default=ROOT / "docs" / "accuracy")
    arguments = parser.parse_args()
    os.chdir(ROOT)  # scenes are named in the tables as they are given
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for name in SCENES if arguments.only is None else (arguments.only,):
        (redraw if arguments.redraw else make)(name, arguments.folder)
    write_index(arguments.folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())

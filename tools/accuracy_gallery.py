"""Makes docs/accuracy: tables and pictures of what accuracy costs in five scenes. `--only NAME` makes one of them."""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any, Final

from canhaptic.scene.load import load_scene
from canhaptic.study.accuracy.picture import draw_accuracy
from canhaptic.study.accuracy.study import AccuracyStudy
from canhaptic.study.accuracy.table import advice_lines, markdown
from tools.bench.report import machine, versions

ROOT: Final = Path(__file__).resolve().parents[1]
SCENES: Final = ("paper_wall", "stiff_stop", "stick_slip", "delayed_bus", "coarse_encoder")
PACKAGES: Final = ("canhaptic", "numpy", "scipy", "mujoco")


def make(name: str, folder: Path) -> None:
    """Writes NAME.json, NAME.md and NAME.png."""
    scene = load_scene(Path("configs") / "accuracy" / f"{name}.yaml")
    result = AccuracyStudy(scene).run()
    document: dict[str, Any] = {"machine": machine(), "versions": versions(PACKAGES), **result}
    (folder / f"{name}.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    draw_accuracy(result, folder / f"{name}.png")
    title = name.replace("_", " ").capitalize()
    comment = _comment(ROOT / "configs" / "accuracy" / f"{name}.yaml")
    text = f"# {title}\n\n{comment}\n\n![{title}]({name}.png)\n\n{markdown(result)}"
    (folder / f"{name}.md").write_text(text, encoding="utf-8")
    print("\n".join([name, *(f"  {line}" for line in advice_lines(result))]))


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
    parser.add_argument("--folder", type=lambda text: Path(text).absolute(), default=ROOT / "docs" / "accuracy")
    arguments = parser.parse_args()
    os.chdir(ROOT)  # scenes are named in the tables as they are given
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for name in SCENES if arguments.only is None else (arguments.only,):
        make(name, arguments.folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())

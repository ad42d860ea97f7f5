"""Makes the moving picture of README, docs/images/touch.gif: `canhaptic touch` in headless Chromium.

    python -m tools.touch_picture [OUT.gif]

It needs Chromium, the extra `report` and Pillow (which matplotlib brings). The page is the real one, in real time; the
frames are what the browser shows.
"""

import base64
import io
import math
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from PIL import Image

from canhaptic.drive.clock import WallClock
from tests.lab.touch.test_touch import FRAME, MODEL, mouse
from tests.view.chromium import Page, chromium

ROOT: Final = Path(__file__).resolve().parents[1]
_SCENE: Final = ROOT / "configs" / "hard" / "stiff_wall.yaml"
_WIDTH, _HEIGHT = 1240, 618  # of the window, in pixels
_SHOWN: Final = 800  # width of the picture, in pixels
_SWING: Final = 3.0  # [s] from one contact to the next
_SWINGS: Final = 2
_COLOURS: Final = 64  # a power of two, as the file has it


def main(arguments: list[str]) -> int:
    """Writes the picture; returns 0."""
    out = Path(arguments[0]) if arguments else ROOT / "docs" / "images" / "touch.gif"
    with chromium(width=_WIDTH, height=_HEIGHT) as page, _touch() as address:
        page.open(address)
        page.wait_for("window.Bokeh && Bokeh.documents.length", 60.0)
        page.wait_for(MODEL.format("status") + ".text.includes('cycles')", 60.0)
        frames = list(_frames(page))
    pictures = [_small(data) for _, data in frames]
    times = [time for time, _ in frames]
    lengths = [max(40, round(1e3 * (b - a))) for a, b in zip(times, [*times[1:], times[-1] + 0.5], strict=True)]
    save(out, pictures, lengths)
    sys.stdout.write(f"{out}: {len(pictures)} frames, {out.stat().st_size / 1e3:.0f} kB\n")
    return 0


@contextmanager
def _touch() -> Iterator[str]:
    words = [sys.executable, "-m", "canhaptic", "touch", str(_SCENE), "--port", "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        yield process.stdout.readline().split(" at ")[1].split()[0]
        process.send_signal(signal.SIGINT)


def _frames(page: Page) -> Iterator[tuple[float, bytes]]:
    """Drags the handle to and fro, and yields (time, PNG) of the page as fast as the browser gives it."""
    clock = WallClock(spin_margin=0.0)
    left, top, width, height = page.value(FRAME)
    middle, across = left + 0.5 * width, top + 0.5 * height
    mouse(page, "mouseMoved", middle, across)
    mouse(page, "mousePressed", middle, across)
    start, shown = clock.now(), 0.0
    while (time := 1e-9 * (clock.now() - start)) < _SWING * _SWINGS:
        mouse(page, "mouseMoved", middle + 0.35 * width * math.sin(2.0 * math.pi * time / _SWING + 0.6), across)
        if time - shown > 0.1:
            shown = time
            yield time, base64.b64decode(page.call("Page.captureScreenshot", format="png")["data"])
        else:
            clock.wait_until(clock.now() + 12_000_000)


def _small(data: bytes) -> Any:
    picture = Image.open(io.BytesIO(data)).convert("RGB")
    height = round(picture.height * _SHOWN / picture.width)
    return picture.resize((_SHOWN, height), Image.Resampling.LANCZOS)


def save(out: Path, pictures: list[Any], lengths: list[int]) -> None:
    """Writes pictures in the colours that all of them share, so that none flickers against the one before."""
    width, height = pictures[0].size
    whole = Image.new("RGB", (width, height * len(pictures)))
    for number, picture in enumerate(pictures):
        whole.paste(picture, (0, height * number))
    shared = whole.quantize(_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    shared_by = [picture.quantize(palette=shared, dither=Image.Dither.NONE) for picture in pictures]
    palette = bytes(shared.getpalette() or ())[: 3 * _COLOURS]
    shared_by[0].save(
        out, save_all=True, append_images=shared_by[1:], duration=lengths, loop=0, palette=palette, optimize=False
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

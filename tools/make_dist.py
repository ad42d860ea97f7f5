"""Builds sdist and wheel into dist/, the same bytes of the same commit: `python -m tools.make_dist [FOLDER]`.

SOURCE_DATE_EPOCH [s] is the time of every file; by default that of the commit. It uses the setuptools of this
environment, which `constraints.txt` pins, and no network.
"""

import gzip
import hashlib
import os
import subprocess
import sys
import tarfile
from pathlib import Path
from typing import Final

from setuptools import build_meta

ROOT: Final = Path(__file__).resolve().parents[1]


def main(arguments: list[str]) -> int:
    """Writes both files and prints the SHA-256 of each; returns 0."""
    out = Path(arguments[0] if arguments else ROOT / "dist").absolute()
    out.mkdir(parents=True, exist_ok=True)
    os.chdir(ROOT)
    words = ["git", "log", "-1", "--format=%ct"]
    epoch = os.environ.setdefault("SOURCE_DATE_EPOCH", "") or subprocess.check_output(words, text=True).strip()
    os.environ["SOURCE_DATE_EPOCH"] = epoch
    source = out / build_meta.build_sdist(str(out))
    repack(source, int(epoch))
    for file in (source, out / build_meta.build_wheel(str(out))):
        sys.stdout.write(f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n")
    return 0


def repack(path: Path, epoch: int) -> None:
    """Packs an sdist again with one time, no owner, and names in order, none of which setuptools does."""
    with tarfile.open(path) as old:
        parts = [(entry, old.extractfile(entry)) for entry in sorted(old, key=lambda entry: entry.name)]
        with (
            path.with_suffix(".new").open("wb") as raw,
            gzip.GzipFile("", "wb", 9, raw, epoch) as packed,
            tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as new,
        ):
            for entry, content in parts:
                entry.mtime, entry.uid, entry.gid, entry.uname, entry.gname = epoch, 0, 0, "", ""
                entry.mode, entry.pax_headers = 0o755 if entry.isdir() or entry.mode & 0o100 else 0o644, {}
                new.addfile(entry, content)
    path.with_suffix(".new").replace(path)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

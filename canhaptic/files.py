"""Reading of input files, writing of output files, and the scenes and dictionaries that come with the package.

An input file must be regular and of bounded size, since a pipe or a device has no end. An output file must be regular
or new, and it is replaced as a whole or not at all; symbolic links are not followed.
"""

import errno
import os
import secrets
import stat
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from canhaptic.errors import InputError, SceneError
from canhaptic.registry import nearest

_KINDS: Final = {
    stat.S_IFREG: "",
    stat.S_IFLNK: "a symbolic link",
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def _kind_of(mode: int) -> str:
    """Return the kind of a file that is not regular, such as "a folder"; "" for a regular file."""
    return _KINDS.get(stat.S_IFMT(mode), "no file")


def require_regular(path: str | Path) -> os.stat_result:
    """Return the status of a regular file; symbolic links are followed.

    Raises:
        OSError: The file does not exist or is not regular; `strerror` says which.
    """
    try:
        found = os.stat(path)
    except FileNotFoundError as error:
        raise FileNotFoundError(error.errno, "no such file", str(path)) from error
    except ValueError as error:  # a text that no path can be
        raise OSError(errno.EINVAL, str(error), str(path)) from error
    if kind := _kind_of(found.st_mode):
        raise OSError(errno.EINVAL, f"is {kind}", str(path))
    return found


def read_regular(path: str | Path, most: int) -> bytes:
    """Return the content of a regular file.

    Args:
        path: Path of the file.
        most: Largest accepted size [bytes].

    Raises:
        OSError: The file is not regular, is larger, or cannot be read; `strerror` says which.
    """
    require_regular(path)
    with open(path, "rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"larger than {most} bytes", str(path))
    return content


def why_not_written(path: Path) -> str:
    """Return why a path cannot be written; "" if it is free or a regular file."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return ""
    except OSError as error:
        return f"{path}: {error.strerror}; choose a folder that exists and may be written"
    kind = _kind_of(mode)
    return f"{path}: is {kind}, expected a regular file or none; name another file" if kind else ""


def require_writable_place(path: Path) -> None:
    """Refuse a path that is neither free nor a regular file.

    Raises:
        InputError: The path is a folder, a link, a device or the like.
    """
    if reason := why_not_written(path):
        raise InputError(reason)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a new, empty file in the folder of `path`; it replaces `path` if the block ends well.

    Raises:
        InputError: `path` is neither free nor a regular file.
        OSError: The new file cannot be created.
    """
    require_writable_place(path)
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(8)}{path.suffix}")
    os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    try:
        yield temporary
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


CONVERTIBLE: Final = frozenset({".blf", ".trc", ".asc"})
"""Suffixes of bus logs that python-can reads and writes."""


FOLDERS: Final = ("configs", "eds")

_TREE: Final = Path(__file__).resolve().parent.parent


def shipped(folder: str) -> Path:
    """Return a folder of the package: in the source tree, else where its wheel installed it.

    Args:
        folder: One of `FOLDERS`.
    """
    of_tree = _TREE / folder
    installed = Path(sysconfig.get_path("data")) / "share" / "canhaptic" / folder
    of_target = _TREE / "share" / "canhaptic" / folder  # pip install --target
    return next((place for place in (of_tree, installed, of_target) if place.is_dir()), installed)


def scene_names() -> list[str]:
    """Return the names of the shipped scenes: their paths below `configs/`, without `.yaml`."""
    folder = shipped("configs")
    return sorted(path.relative_to(folder).with_suffix("").as_posix() for path in folder.rglob("*.yaml"))


def scene_title(source: str) -> str:
    """Return the name of a scene for a heading: its file without folder and ending, or a source that is no file."""
    return Path(source).stem if source.endswith((".yaml", ".yml")) else source


def scene_file(path: Path) -> Path:
    """Return the file of a scene: `path` if it exists, else the shipped scene of that name.

    Args:
        path: A file; or a name such as `hard/stiff_wall` or, where only one scene has it, `stiff_wall`.

    Raises:
        SceneError: Several shipped scenes have this name, or no file and no scene has it.
    """
    if path.exists() or path.is_absolute():
        return path
    name = path.as_posix().removeprefix("configs/").removesuffix(".yaml")
    names = scene_names()
    found = [name] if name in names else [known for known in names if known.split("/")[-1] == name]
    if len(found) == 1:
        return shipped("configs") / f"{found[0]}.yaml"
    if found:
        raise SceneError([f"{path}: {len(found)} scenes have this name: {', '.join(found)}; give one of these"])
    if len(path.parts) > 1 and path.parent.is_dir():
        names = [entry.as_posix() for entry in path.parent.glob("*.yaml")] + names
    near = nearest(name, names, 2) or nearest(name, [known.split("/")[-1] for known in names], 2)
    text = f"{path}: cannot be read (no such file), and no scene of the package has this name"
    raise SceneError([f"{text}{near or '; `canhaptic configs` lists the scenes'}"])

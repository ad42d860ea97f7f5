"""A machine to boot: Debian's kernel with its CAN modules, this interpreter, this package and what it depends on.

Nothing is installed on the host: the kernel's package is fetched and unpacked into a folder, and the root of the guest
is a read-only squashfs of files that are on the host already.
"""

import compileall
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
PROJECT = HERE.parents[1]
KERNEL_PACKAGE = "linux-image-amd64"
MODULES = ("squashfs", "virtio_pci", "virtio_blk", "can-raw", "vcan", "sja1000", "kvaser_pci")
TOOLS = ("qemu-system-x86_64", "mksquashfs", "cpio", "depmod", "apt-get", "dpkg-deb", "ip", "busybox")
"""From Debian's qemu-system-x86, squashfs-tools, cpio, kmod, apt, dpkg, iproute2 and busybox-static."""
UNUSED = shutil.ignore_patterns(
    "test", "tests", "idlelib", "tkinter", "turtledemo", "ensurepip", "site-packages", "config-*", "__pycache__"
)


class Image(NamedTuple):
    """What the machine boots from."""

    kernel: Path
    initial: Path  # initramfs: busybox and modules
    root: Path  # squashfs


def missing_tools() -> list[str]:
    """Returns the programs that the host lacks."""
    search = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"
    return [tool for tool in TOOLS if shutil.which(tool, path=search) is None]


def build_image(folder: Path) -> Image:
    """Returns an image built in `folder`; the kernel is taken from there if it was unpacked before.

    Raises:
        subprocess.CalledProcessError: A tool failed; for `apt-get` its message says why the package cannot be had.
    """
    kernel_tree = _unpacked_kernel(folder)
    [kernel] = sorted((kernel_tree / "boot").glob("vmlinuz-*"))
    release = kernel.name.removeprefix("vmlinuz-")
    return Image(kernel, _initial(folder, kernel_tree, release), _root(folder))


def _run(*command: str | Path, folder: Path) -> str:
    """Runs a command and returns what it printed."""
    environment = {**os.environ, "PATH": os.environ.get("PATH", "") + ":/usr/sbin:/sbin"}
    return subprocess.run(
        [str(word) for word in command], cwd=folder, env=environment, check=True, capture_output=True, text=True
    ).stdout


def _unpacked_kernel(folder: Path) -> Path:
    tree = folder / "kernel"
    if not tree.is_dir():
        listed = _run("apt-cache", "depends", "--important", KERNEL_PACKAGE, folder=folder)
        found = re.search(r"Depends: (linux-image-\S+)", listed)
        if found is None:
            raise FileNotFoundError(f"apt-cache: got no kernel behind {KERNEL_PACKAGE}; run `apt-get update` first")
        _run("apt-get", "download", found[1], folder=folder)
        [package] = folder.glob("linux-image-*.deb")
        unpacking = folder / "kernel.part"
        _run("dpkg-deb", "-x", package, unpacking, folder=folder)
        package.unlink()
        unpacking.rename(tree)
    return tree


def _initial(folder: Path, kernel_tree: Path, release: str) -> Path:
    """Packs busybox, the modules in the order of their dependencies, and `guest/init`."""
    stage = _empty(folder / "initial")
    for name in ("bin", "dev", "proc", "sys", "root", "modules"):
        (stage / name).mkdir()
    shutil.copy2(_which("busybox"), stage / "bin/busybox")
    _run("depmod", "-b", kernel_tree, release, folder=folder)
    files = _modules_in_order(kernel_tree / "lib/modules" / release)
    for file in files:
        shutil.copy2(file, stage / "modules")
    (stage / "modules/order").write_text("".join(f"{file.name}\n" for file in files))
    shutil.copy2(HERE / "guest/init", stage / "init")
    (stage / "init").chmod(0o755)
    packed = folder / "initial.cpio"
    _run("sh", "-c", f"find . | cpio --quiet -o -H newc > '{packed}'", folder=stage)
    return packed


def _modules_in_order(tree: Path) -> list[Path]:
    lines = dict(line.split(":", 1) for line in (tree / "modules.dep").read_text().splitlines())
    place = {Path(name).name.split(".ko")[0].replace("-", "_"): name for name in lines}
    order: list[str] = []
    for module in MODULES:
        name = place.get(module.replace("-", "_"))
        if name is None:  # built into this kernel
            continue
        for needed in [*reversed(lines[name].split()), name]:
            if needed not in order:
                order.append(needed)
    return [tree / name for name in order]


def _root(folder: Path) -> Path:
    """Packs the interpreter, the package, its dependencies, the scenes and the shared libraries of them all."""
    stage = _empty(folder / "root")
    for name in ("bin", "dev", "proc", "sys", "tmp", "run", "packages"):
        (stage / name).mkdir()
    _copy_interpreter(stage)
    _copy_packages(stage / "packages")
    for name in ("configs", "eds"):
        shutil.copytree(PROJECT / name, stage / "packages" / name)
    shutil.copytree(HERE / "guest", stage / "guest", ignore=UNUSED)
    for program in ("busybox", "ip"):
        shutil.copy2(_which(program), stage / "bin" / program)
    _copy_libraries(stage, folder)
    compileall.compile_dir(stage / "packages", quiet=2, stripdir=str(stage), workers=1)
    packed = folder / "root.squashfs"
    packed.unlink(missing_ok=True)
    _run("mksquashfs", stage, packed, "-noI", "-noD", "-noF", "-noX", "-quiet", "-all-root", folder=folder)
    return packed


def _copy_interpreter(stage: Path) -> None:
    """Copies the interpreter that runs this to the same place in the guest, and names it in `/guest/python`."""
    program = Path(sys.executable).resolve()
    _copy_to_same_place(program, stage)
    library = sysconfig.get_config_var("LDLIBRARY")
    for file in Path(sysconfig.get_config_var("LIBDIR") or "/").glob(f"{library}*" if library else ""):
        _copy_to_same_place(file, stage)
    standard = Path(sysconfig.get_path("stdlib"))
    shutil.copytree(standard, stage / standard.relative_to("/"), ignore=UNUSED)
    compileall.compile_dir(stage / standard.relative_to("/"), quiet=2, stripdir=str(stage), workers=1)
    (stage / "python").write_text(f"{program}\n")


def _copy_packages(place: Path) -> None:
    for name in sorted(_closure("canhaptic") - {"canhaptic"}):
        distribution = importlib.metadata.distribution(name)
        for file in distribution.files or []:
            source = Path(str(distribution.locate_file(file)))
            if ".." in file.parts or "tests" in file.parts or source.suffix == ".pyc" or not source.is_file():
                continue
            target = place / file
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target)
    shutil.copytree(PROJECT / "canhaptic", place / "canhaptic", ignore=UNUSED)
    about = place / "canhaptic-0.dist-info"  # the package asks for its own version
    about.mkdir()
    version = importlib.metadata.version("canhaptic")
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: canhaptic\nVersion: {version}\n")


def _closure(name: str, found: set[str] | None = None) -> set[str]:
    """Returns a distribution and everything it requires without extras, as far as it is installed."""
    found = set() if found is None else found
    name = re.split(r"[ ;<>=!~\[(]", name)[0].lower().replace("_", "-")
    if name not in found:
        try:
            requires = importlib.metadata.requires(name) or []
        except importlib.metadata.PackageNotFoundError:  # for another system or version
            return found
        found.add(name)
        for required in requires:
            if "extra ==" not in required:
                _closure(required, found)
    return found


def _copy_libraries(stage: Path, folder: Path) -> None:
    """Copies every shared library that a staged program or module is linked to, to its own place."""
    linked = [path for path in stage.rglob("*") if path.is_file() and (".so" in path.name or path.parent.name == "bin")]
    for library in sorted(_libraries(linked, folder)):
        _copy_to_same_place(library, stage)


def _libraries(files: Iterable[Path], folder: Path) -> set[Path]:
    found: set[Path] = set()
    for file in files:
        done = subprocess.run(["ldd", str(file)], cwd=folder, capture_output=True, text=True, check=False)
        found |= {Path(place) for place in re.findall(r"(/\S+\.so\S*) \(0x", done.stdout)}
    return {library for library in found if not library.is_relative_to(folder)}


def _copy_to_same_place(file: Path, stage: Path) -> None:
    target = stage / file.relative_to("/")
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy2(file, target)


def _which(program: str) -> str:
    found = shutil.which(program, path=os.environ.get("PATH", "") + ":/usr/sbin:/sbin")
    if found is None:
        raise FileNotFoundError(f"{program}: not found; install the packages that README.md of this folder names")
    return found


def _empty(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder

"""The arguments of every subcommand; its code is in the module of its name, imported after parsing.

Arguments that several subcommands share.

Parsers of option values, each with an error that states the expected form.
"""

import argparse
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canhaptic.errors import InputError
from canhaptic.host.output_file import require_writable_place
from canhaptic.logs.log_file import CONVERTIBLE

if TYPE_CHECKING:
    from canhaptic.scene.models import Scene

_PICTURES: Final = (".png", ".svg", ".pdf")
"""Suffixes of a picture."""


def add_scene(parser: argparse.ArgumentParser, *, runs: bool = True) -> None:
    """Declare the scene file and its overrides, and for a command that runs the scene `--allow-code`."""
    parser.add_argument("config", metavar="CONFIG", type=Path, help="scene file (YAML), or the name of a shipped scene")
    add_overrides(parser)
    if runs:
        add_allow_code(parser)


def add_allow_code(parser: argparse.ArgumentParser) -> None:
    """Declare `--allow-code`."""
    parser.add_argument(
        "--allow-code", action="store_true", help="run the program files that the scene names (type: my_wall.py:MyWall)"
    )


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """Declare `--set`."""
    parser.add_argument(
        "--set",
        dest="overrides",
        metavar="PATH=VALUE",
        action="append",
        default=[],
        help="override a value of the scene, as in axes.0.node_id=5 or environment.stiffness='500 N/m'; repeatable",
    )


def add_json(parser: argparse.ArgumentParser, what: str = "one JSON object instead of tables") -> None:
    """Declare `--json`."""
    parser.add_argument("--json", action="store_true", help=f"print {what}")


def scene_of(arguments: argparse.Namespace, *, beyond_bus: bool = False) -> "Scene":
    """Return the scene that the arguments name; `beyond_bus` as for `load_scene`.

    A command without `--allow-code` runs no scene, and does not load user code.

    Raises:
        SceneError: Anything in it is wrong.
    """
    from canhaptic.scene.load import load_scene

    allow_code: bool | None = getattr(arguments, "allow_code", None)
    return load_scene(
        arguments.config,
        arguments.overrides,
        allow_code=bool(allow_code),
        leave_code=allow_code is None,
        beyond_bus=beyond_bus,
    )


def check_picture(path: Path) -> None:
    """Refuse a picture that could not be written, before the run.

    Raises:
        InputError: An unknown suffix, no place for it, or matplotlib is not installed.
    """
    if path.suffix not in _PICTURES:
        raise InputError(f"{path}: expected a name that ends in {', '.join(_PICTURES[:-1])} or {_PICTURES[-1]}")
    check_place(path)
    from canhaptic.view.picture_style import require_matplotlib

    require_matplotlib()


def check_page(path: Path) -> None:
    """Refuse a page that could not be written, before the run.

    Raises:
        InputError: There is no place for it, or matplotlib is not installed.
    """
    from canhaptic.view.picture_style import require_matplotlib

    check_place(path)
    require_matplotlib()


def check_place(path: Path) -> None:
    """Refuse a file that could not be written, before the run.

    Raises:
        InputError: There is no folder for it, or its path is no regular file.
    """
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: no such folder {path.absolute().parent}; make it first")
    require_writable_place(path)


def require_new(*logs: Path) -> None:
    """Refuse logs that would overwrite a file, before the run.

    Raises:
        InputError: One of them exists, or the remains of a killed run's log.
    """
    for path in logs:
        unfinished = [path.with_name(f"{path.name}.log")] if path.suffix.lower() in CONVERTIBLE else []
        for taken in filter(Path.exists, [path, *unfinished]):
            raise InputError(f"{taken} already exists; --force replaces it, or name another file")


def seconds(text: str) -> float:
    """Return a duration [s] from `10`, `10 s`, `500 ms` or `2 min`.

    Raises:
        argparse.ArgumentTypeError: It is none, or not above zero.
    """
    return positive_number(text, ("s", "s"), "duration", 1e6)


def number(text: str, units: tuple[str, str]) -> float:
    """Return a number in SI from a text; `units` and errors as for `positive_number`."""
    from canhaptic.units import Unit

    try:
        return float(str(Unit(*units).read(text)))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"got {text!r}, {error}") from error


def positive_number(text: str, units: tuple[str, str], name: str, most: float) -> float:
    """Return a number above zero, SI, from a text with or without its unit.

    Args:
        text: The text as typed.
        units: Accepted units for linear and for rotary motion.
        name: Name of the quantity, for the message.
        most: Largest accepted value.

    Raises:
        argparse.ArgumentTypeError: It is no number of this dimension, or out of range.
    """
    value = number(text, units)
    if not 0.0 < value <= most:
        shown = " or ".join(dict.fromkeys(units))
        raise argparse.ArgumentTypeError(f"got {text!r}, expected 0 < {name} <= {most:g} [{shown}]")
    return value


def names(text: str) -> list[str]:
    """Return a comma-separated list of names.

    Raises:
        argparse.ArgumentTypeError: There is none.
    """
    found = [name.strip() for name in text.split(",") if name.strip()]
    if not found:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected names with commas")
    return found


_FASTEST: Final = 1e6  # [Hz]
_DIGITS: Final = re.compile(r"[0-9]{1,12}")


def length(text: str) -> float:
    """Return a tolerance [m or rad]."""
    return positive_number(text, ("m", "rad"), "tolerance", 1.0)


def budget(text: str) -> float:
    """Return a time to spend [s], 0 for none."""
    return 0.0 if text.strip() == "0" else seconds(text)


def rate(text: str) -> float:
    """Return a rate [Hz]."""
    return positive_number(text, ("Hz", "Hz"), "rate", _FASTEST)


def rates(text: str) -> list[float]:
    """Return a comma-separated list of rates [Hz], each once."""
    return list(dict.fromkeys(rate(one) for one in names(text)))


def delays(text: str) -> list[int]:
    """Return a comma-separated list of delays, 0 or 1 hold, each once."""
    given = list(dict.fromkeys(names(text)))
    if not set(given) <= {"0", "1"}:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected 0 (event), 1 (synchronous) or 0,1")
    return [int(one) for one in given]


def moment(text: str) -> float:
    """Return a time of a log [s]."""
    return number(text, ("s", "s"))


def whole(least: int, most: int) -> Callable[[str], int]:
    """Parser of a whole number within limits."""

    def read(text: str) -> int:
        if not _DIGITS.fullmatch(text) or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"got {text!r}, expected a whole number from {least} to {most}")
        return int(text)

    return read


def samples(text: str) -> int:
    """Return the points of a Latin hypercube from `lhs:N`."""
    kind, _, points = text.partition(":")
    if kind != "lhs":
        raise argparse.ArgumentTypeError(f"got {text!r}, expected lhs:N with N from 1 to 10^8")
    return whole(1, 100_000_000)(points)


PORT: Final = whole(0, 65_535)
"""Reads the port of a page; 0 for any that is free."""


TORQUE, TRAVEL, SPEED = 0.1, 0.02, 0.5
"""As in `commission.session.CommissioningLimits`, which is imported when commissioning begins."""


def _check(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `check`."""
    add_scene(parser, runs=False)
    parser.add_argument("--resolved", action="store_true", help="print every value in effect, as YAML")
    parser.add_argument("--full", action="store_true", help="print every object, limit and setting with its reason")
    text = "also read the limits, ramps and reactions that the drives keep, by SDO; nothing is written or enabled"
    parser.add_argument("--bus", action="store_true", help=text)
    add_json(parser)


def _check_eds(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `check-eds`."""
    parser.add_argument("file", metavar="FILE", type=Path, help="object dictionary of the drive (EDS or DCF)")
    _add_display(parser)
    add_json(parser)


def _add_display(parser: argparse.ArgumentParser) -> None:
    """Declare the choice of the kind of display for a dictionary."""
    parser.add_argument(
        "--display", choices=("velocity", "position"),
        help="judge it for an admittance display (force in, velocity out) in mode 9 or 8; by default for cyclic torque",
    )  # fmt: skip
    parser.add_argument(
        "--force-object", metavar="0xINDEX.SUB",
        help="object that shows the force of an admittance display; by default a known analog input of the make",
    )  # fmt: skip


def _commission(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `commission`."""
    add_scene(parser)
    parser.add_argument(
        "--yes", action="store_true", help="agree to every step; only where all drives are simulated in this process"
    )
    parser.add_argument(
        "--torque", metavar="PART", type=float, default=TORQUE,
        help=f"largest torque, as a part of the rated torque; {TORQUE:g} by default, 0.3 at most",
    )  # fmt: skip
    parser.add_argument(
        "--travel", metavar="X", type=float, default=TRAVEL,
        help=f"distance [m or rad] after which a torque is taken away; {TRAVEL:g} by default",
    )  # fmt: skip
    parser.add_argument(
        "--speed", metavar="V", type=float, default=SPEED,
        help=f"speed [m/s or rad/s] after which a torque is taken away; {SPEED:g} by default",
    )  # fmt: skip
    parser.add_argument("--duration", metavar="S", type=seconds, default=10.0, help="length of the timing test [s]")
    written = parser.add_mutually_exclusive_group()
    written.add_argument("--out", metavar="FILE.yaml", type=Path, help="write the scene with the values to a new file")
    written.add_argument(
        "--in-place", action="store_true", help="replace the scene by it, and keep the one before as CONFIG.bak"
    )
    add_json(parser)


def _configs(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `configs`."""
    parser.add_argument(
        "--copy", metavar="FOLDER", type=Path, help="put configs/ and eds/ into FOLDER; nothing there is overwritten"
    )
    add_json(parser)


def _decode(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `decode`."""
    parser.add_argument("bus_log", type=Path, metavar="BUSLOG", help="candump text, BLF, TRC or ASC")
    parser.add_argument("--config", type=Path, metavar="CONFIG", help="scene file, for names, units and dictionaries")
    parser.add_argument("--from", dest="start", type=moment, metavar="S", help="from this time on [s]")
    parser.add_argument("--to", dest="stop", type=moment, metavar="S", help="up to this time [s]")
    parser.add_argument("--only", action="append", metavar="KIND", help="NMT, SYNC, EMCY, SDO, TPDO1, heartbeat, ...")
    add_json(parser, "one JSON object per line")


def _drive(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `drive`."""
    add_scene(parser)
    parser.add_argument("--duration", metavar="S", type=seconds, help="duration [s]; by default until stopped")


def _evidence(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `evidence`."""
    add_scene(parser)
    parser.add_argument("--out", metavar="FOLDER", type=Path, required=True, help="new folder for the evidence")
    parser.add_argument("--duration", metavar="S", type=seconds, default=5.0, help="length of each run [s]")
    parser.add_argument("--travel", metavar="X", type=float, default=TRAVEL, help="as for `commission`")
    parser.add_argument("--anonymous", action="store_true", help="leave out comments, names and serial numbers")
    parser.add_argument("--yes", action="store_true", help="agree to every step; only with simulated drives")


def _inspect(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `inspect`."""
    parser.add_argument("log", type=Path, help="an energy log (.h5), or a bus log together with --config")
    parser.add_argument("--from", dest="start", type=moment, metavar="S", help="count from this time on [s]")
    parser.add_argument("--to", dest="stop", type=moment, metavar="S", help="count up to this time [s]")
    add_allow_code(parser)
    add_json(parser)
    parser.add_argument(
        "--check",
        action="append",
        default=[],
        metavar="EXPRESSION",
        help="exit with 1 unless it holds: 'passive', 'margin >= -1 uJ', 'handle.deficit == 0', 'compute.p99 < 50 us'",
    )
    parser.add_argument(
        "--compare", type=Path, metavar="OTHER", help="exit with 1 unless the other log is the same; pictures show both"
    )
    _inspect_files(parser)
    parser.add_argument(
        "--recompute",
        action="store_true",
        help="feed the logged inputs to the controllers again; exit with 1 unless every output is equal bit for bit",
    )
    parser.add_argument(
        "--config", type=Path, metavar="CONFIG", help="scene of the run; by default the one the log names"
    )
    parser.add_argument(
        "--bus-log",
        type=Path,
        metavar="FILE",
        help="derive the account again from the frames alone; exit with 1 unless it equals that of the log bit for bit",
    )
    parser.add_argument("--repair", type=Path, metavar="FILE", help="save all that can be read into a clean log")


def _inspect_files(parser: argparse.ArgumentParser) -> None:
    """Declare the files that `inspect` writes."""
    parser.add_argument(
        "--overlay", type=Path, action="append", default=[], metavar="OTHER",
        help="draw another log over this one in pictures and page; repeatable",
    )  # fmt: skip
    tables = {"--csv": "a table of every row (PlotJuggler)", "--parquet": "the same", "--mat": "the same"}
    for option, what in {**tables, "--mcap": "every row as messages (Foxglove, PlotJuggler)"}.items():
        parser.add_argument(option, type=Path, metavar="FILE", help=f"write {what}")
    for option in ("--png", "--svg"):
        parser.add_argument(option, type=Path, metavar="FILE", help="draw the run")
    parser.add_argument(
        "--html", type=Path, metavar="FILE", help="write one self-contained page: pictures, account, contacts, events"
    )


def _new(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `new`."""
    parser.add_argument("file", metavar="EDS", type=Path, help="object dictionary of the drive (EDS or DCF)")
    parser.add_argument(
        "--out",
        metavar="FILE.yaml",
        type=Path,
        help="write the scene there, with the path of the EDS as seen from there; by default it is printed, with the "
        "whole path",
    )
    parser.add_argument(
        "--simulate", action="store_true", help="with a simulated drive, motor and hand, so that it runs at once"
    )
    _add_display(parser)


def _home(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `home`."""
    add_scene(parser)
    parser.add_argument("--axis", metavar="NAME", help="axis of a scene with several")
    parser.add_argument(
        "--method", metavar="N", type=int, required=True,
        help="0x6098: 33, 34 next index; 17, 18 limit switch; 1, 2 switch, then index; 35, 37 the present position",
    )  # fmt: skip
    parser.add_argument(
        "--speed", metavar=("SWITCH", "ZERO"), type=float, nargs=2, required=True,
        help="speeds [m/s or rad/s] towards a switch (0x6099:01) and towards the zero (0x6099:02)",
    )  # fmt: skip
    parser.add_argument(
        "--torque", metavar="T", type=float, required=True,
        help="largest torque of the homing [N or N*m] (0x6072), at most torque_limit",
    )  # fmt: skip
    parser.add_argument(
        "--timeout", metavar="S", type=float, default=30.0, help="time after which it is stopped; 30 s by default"
    )
    parser.add_argument("--yes", action="store_true", help="answer yes to everything: for simulated drives alone")


def _lss(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `lss`."""
    add_scene(parser, runs=False)
    parser.add_argument("node", metavar="NODE", type=int, help="node ID to give, 1 to 127")
    parser.add_argument(
        "--identity", nargs=4, type=lambda text: int(text, 0), metavar=("VENDOR", "PRODUCT", "REVISION", "SERIAL"),
        help="the four numbers of its 0x1018; without them it is alone on the bus",
    )  # fmt: skip
    parser.add_argument("--bus", metavar="NAME", help="bus of a scene with several")
    parser.add_argument("--yes", action="store_true", help="answer yes to everything: for simulated drives alone")


def _preflight(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `preflight`."""
    add_scene(parser, runs=False)
    add_json(parser)


def _replay(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `replay`."""
    parser.add_argument("bus_log", type=Path, metavar="BUSLOG", help="candump text, BLF, TRC or ASC")
    parser.add_argument("--config", type=Path, metavar="CONFIG", required=True, help="scene of the recorded run")
    add_overrides(parser)
    parser.add_argument(
        "--energy-log",
        type=Path,
        metavar="LOG",
        help="of the same run: the scene as it ran then, and the code it named, which must be the same",
    )
    parser.add_argument("--realtime", action="store_true", help="keep the pace of the recording")
    parser.add_argument(
        "--from-sync", action="store_true", help="leave the start of the drives out, even if it was recorded"
    )
    parser.add_argument(
        "--no-torque", action="store_true", help="the recorded run sent no torque (an energy log says so itself)"
    )
    parser.add_argument("--account", action="store_true", help="print the energy account of the replayed run, too")
    add_allow_code(parser)
    add_json(parser)


def _run(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `run`."""
    add_scene(parser)
    parser.add_argument("--duration", metavar="S", type=seconds, help="length of the run [s]; by default the scene's")
    parser.add_argument(
        "--pace",
        choices=("real", "free"),
        help="wall-clock pace, or as fast as the machine allows in lock-step; by default free where all is simulated",
    )
    parser.add_argument(
        "--no-torque", action="store_true",
        help="dry run: the drives are enabled and every torque that is sent is 0; the log holds the requests",
    )  # fmt: skip
    parser.add_argument("--large-allowance", action="store_true", help="accept an energy_allowance above 10 mJ")
    parser.add_argument("--log", metavar="FILE.h5", type=Path, help="energy log (HDF5)")
    parser.add_argument("--bus-log", metavar="FILE.log", type=Path, help="bus log (candump text)")
    parser.add_argument("--force", action="store_true", help="replace logs that exist")
    parser.add_argument("--png", metavar="FILE", type=Path, help="picture of the run (.png, .svg, .pdf)")
    parser.add_argument(
        "--strict", action="store_true", help="exit with 1 unless every port that was touched is shown as passive"
    )
    parser.add_argument("--full", action="store_true", help="print every figure of the account")
    add_json(parser)


def _schema(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `schema`: none."""


def _scope(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `scope`."""
    parser.add_argument("log", type=Path, nargs="?", metavar="LOG", help="energy log that a run writes or will write")
    parser.add_argument("--config", type=Path, metavar="CONFIG", help="scene file that names the log (log.energy)")
    parser.add_argument("--port", type=PORT, default=5006, metavar="N", help="port of the page; 0: any free one")
    parser.add_argument("--window", type=float, default=10.0, metavar="S", help="seconds shown")
    parser.add_argument("--open", action="store_true", help="open the page in a browser")


OPTIONS: Final[dict[str, Callable[[argparse.ArgumentParser], None]]] = {
    "check": _check,
    "check-eds": _check_eds,
    "commission": _commission,
    "configs": _configs,
    "decode": _decode,
    "drive": _drive,
    "evidence": _evidence,
    "home": _home,
    "inspect": _inspect,
    "lss": _lss,
    "new": _new,
    "preflight": _preflight,
    "replay": _replay,
    "run": _run,
    "schema": _schema,
    "scope": _scope,
}
"""Subcommand -> what declares its arguments."""

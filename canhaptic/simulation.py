"""A scene simulated from Python, and its result: the account of energy, every sampled quantity, and pictures.

import canhaptic

result = canhaptic.simulate("configs/demo.yaml", {"environment.stiffness": "500 N/m"})
print(result.account["handle"].margin)       # [J]
result.plot()
"""

import base64
import html
import importlib
import io
import json
import shutil
import sys
import tempfile
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, field, fields
from functools import cached_property, partial
from math import nan
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from canhaptic.control.verdict import RESTS_ON, WORST_LAST, Headline, Verdict
from canhaptic.errors import CanHapticError, InputError
from canhaptic.logs import energy_reader
from canhaptic.result import RunResult
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene, scene_from_mapping
from canhaptic.scene.models import RunParameters, Scene
from canhaptic.units import shown
from canhaptic.view.terminal import run_progress

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

    from canhaptic.audit.inspection import Inspection


_LOG_NAME: Final = "run.h5"


@dataclass(frozen=True, slots=True)
class PortAccount:
    """The energy account of one axis, or of a group of axes. Energies in [J].

    Attributes:
        name: Name of the axis or group.
        energy_in: Energy received through the port.
        energy_out: Energy delivered through the port.
        stored: Energy that the virtual environment stores at the end.
        dissipated: Energy that the virtual environment dissipated; NaN, as not known, for the torques of a program.
        deficit: Sum of the energy delivered beyond the stored energy.
        margin: Least value of the summed interaction energy minus the dissipated energy (eq. 4); below 0: sampling
            created energy, and `passive` says whether it reached the hand.
        least_interaction: Least value of the summed interaction energy (eq. 3), as accounted by the controller.
        true_least_interaction: The same from the plant's energy; NaN for an axis without its own simulated plant.
        certificate: Name of the weakest certificate of the run; `none` if nothing was certified.
        passive: Displayed verdict: by the simulated plant if it is known, else by the account, at the handle if damping
            or friction of the device is declared. An axis in a group has the group's verdict.
        verdict: The same, or that there is none ("nothing rendered", "no contact", "dry run").
        why: Grounds of the account's yes, or the reason of its doubt; empty for a no.
        passive_at_motor: Verdict on `least_interaction` from the account alone.
        passive_at_handle: The same including what the device dissipated; None without declared damping or friction.
        energy_resolution: Largest error of the accounted sum of energy [J].
        certificates: Every certificate of the run, with the declared properties that it rests on.
        hold: Whether a test has found the hold in which the torques act; empty for a display.
        plant_passive: Verdict from the energy of the simulated plant.
        first_active: First time at which the summed interaction energy was below 0 [s]; None: never.
        active_since: First time at which the port had certainly generated energy [s]; None: never.
        advice: Cause and remedy if nothing was rendered; empty otherwise.
        group: Group of the axis, whose account applies; empty for an axis outside groups.
        mass_felt: Mass felt at an admittance display [kg or kg*m^2]; None: no mass is rendered, or it is unknown.
    """

    name: str
    energy_in: float
    energy_out: float
    stored: float
    dissipated: float
    deficit: float
    margin: float
    least_interaction: float
    true_least_interaction: float
    certificate: str
    passive: Verdict
    verdict: Headline
    why: str = ""
    passive_at_motor: Verdict = "in doubt"
    passive_at_handle: Verdict | None = None
    energy_resolution: float = nan
    certificates: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    hold: str = ""
    plant_passive: Verdict | None = None
    first_active: float | None = None
    active_since: float | None = None
    advice: str = ""
    group: str = ""
    mass_felt: float | None = None

    def __repr__(self) -> str:
        energies = f"in {self.energy_in:.4g} J, out {self.energy_out:.4g} J, margin {self.margin:.3g} J"
        return f"<PortAccount {self.name}: {self.verdict}, {energies}>"


class Account(Mapping[str, PortAccount]):
    """The accounts of all ports by name; `raw` is the whole account as `canhaptic run --json` prints it.

    `account.handle` is `account["handle"]`, for a name that is no attribute already.

    Example:
        >>> {name: port.margin for name, port in result.account.items()}  # doctest: +SKIP
    """

    def __init__(self, raw: "RunResult | Inspection") -> None:
        self.raw = cast("RunResult", raw.copy())
        self._ports = {name: _port_account(name, raw) for name in raw["ports"]}

    def __getitem__(self, name: str) -> PortAccount:
        return self._ports[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._ports)

    def __len__(self) -> int:
        return len(self._ports)

    def __getattr__(self, name: str) -> PortAccount:
        if (found := self.__dict__.get("_ports", {}).get(name)) is None:
            ports = ", ".join(self.__dict__.get("_ports", {}))
            raise AttributeError(f"got {name!r}, expected a name of a port: {ports}")
        return cast("PortAccount", found)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._ports]

    @property
    def passive(self) -> Verdict:
        """The worst `passive` of all ports; "in doubt" if there are none."""
        return max((port.passive for port in self.values()), key=WORST_LAST.index, default="in doubt")

    @property
    def verdict(self) -> Headline:
        """The worst displayed verdict of any port; see `PortAccount`."""
        return self.raw["verdict"]

    @property
    def first_active(self) -> float | None:
        """First time at which the net energy of any port was below 0 [s]; None: never."""
        return min((port.first_active for port in self.values() if port.first_active is not None), default=None)

    def __repr__(self) -> str:
        return f"<Account: passive {self.verdict}; {', '.join(self._ports)}>"


class EnergyLog(energy_reader.EnergyLog):
    """An energy log, opened for reading, with its account and with tables of its quantities.

    Example:
        >>> with canhaptic.EnergyLog("run.h5") as log:  # doctest: +SKIP
        ...     print(log.account.verdict, log.first_active)
        ...     table = log.to_pandas()
    """

    @cached_property
    def account(self) -> Account:
        """The account of every port, as `canhaptic inspect --json` prints it."""
        from canhaptic.audit.inspection import inspect

        return Account(inspect(self))

    @property
    def first_active(self) -> float | None:
        """First time at which the net energy of any port was below 0 [s]; None: never."""
        return self.account.first_active

    def to_numpy(self) -> dict[str, NDArray[np.float64]]:
        """Return every quantity of every port, as `SimulationResult.to_numpy` does."""
        return {name: values for name, _, values in self._columns()}

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the quantities as a table over time [s]; `table.attrs["units"]` has the unit of each column.

        Raises:
            InputError: pandas is not installed.
        """
        library = _imported("pandas")
        table: pandas.DataFrame = library.DataFrame(self.to_numpy(), index=library.Index(self.time, name="time [s]"))
        table.attrs = {"units": {name: unit for name, unit, _ in self._columns()}, "status": self.status}
        return table

    def to_xarray(self) -> "xarray.Dataset":
        """Return the quantities as a dataset over `time` [s], each with its unit as an attribute.

        Raises:
            InputError: xarray is not installed.
        """
        library = _imported("xarray")
        arrays = {name: ("time", values, {"units": unit}) for name, unit, values in self._columns()}
        time = ("time", self.time, {"units": "s"})
        dataset: xarray.Dataset = library.Dataset(arrays, coords={"time": time}, attrs={"status": self.status})
        return dataset

    def plot(
        self, *others: energy_reader.EnergyLog, panels: Sequence[str] = (), width: float | str | None = None
    ) -> "Figure":
        """Return a figure of the run; as `SimulationResult.plot`, with logs as `others`."""
        from canhaptic.view.run_picture import energy_figure

        _require_runs(others, energy_reader.EnergyLog)
        return energy_figure(self, others=others, panels=panels, width=width)

    def _columns(self) -> list[tuple[str, str, NDArray[np.float64]]]:
        return [
            (f"{prefix}{port}.{name}", quantities.unit(name), np.asarray(quantities[name], dtype=np.float64))
            for prefix, ports in (("", self.ports), ("true.", self.truth))
            for port, quantities in ports.items()
            for name in quantities.every_name()
        ]


def _require_runs(others: Sequence[object], kind: type) -> None:
    for one in others:
        if not isinstance(one, kind):
            text = f"plot: got {one!r}, expected another {kind.__name__} to draw over this one"
            raise InputError(f"{text}; plot(...).savefig('run.pdf') writes the figure into a file")


class SimulationResult:
    """Result of a simulated run: its account, every quantity of its energy log, and pictures.

    The log is kept in a temporary file until the result is deleted; `save` keeps it.

    Attributes:
        scene: The simulated scene.
        account: Energies of each port.
        error: Error that ended the run early; None for a completed run.
        sample_time: Sample time [s].
    """

    def __init__(self, scene: Scene, raw: RunResult, error: CanHapticError | None, folder: Path) -> None:
        self.scene = scene
        self.account = Account(raw)
        self.error = error
        self.sample_time = scene.bus.sample_time
        self._path = folder / _LOG_NAME
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)

    @property
    def status(self) -> str:
        """Status of the run: "completed" or "failed: ..."."""
        return str(self.account.raw["status"])

    @property
    def time(self) -> NDArray[np.float64]:
        """Time of each SYNC since the first [s], shape (n_cycles,)."""
        with self.log() as log:
            return log.time

    def log(self) -> EnergyLog:
        """Open the energy log of the run, for further quantities; close it, or use it in a `with` statement.

        Example:
            >>> with result.log() as log:  # doctest: +SKIP
            ...     print(log.events)
        """
        return EnergyLog(self._path)

    def to_numpy(self) -> dict[str, NDArray[np.float64]]:
        """Return every sampled quantity of every port as an array of shape (n_cycles,), in SI.

        The name is `PORT.QUANTITY`, such as `handle.position`; `true.PORT.QUANTITY` is the plant's value.

        Example:
            >>> depth = result.to_numpy()["handle.position"].min()  # doctest: +SKIP
        """
        with self.log() as log:
            return log.to_numpy()

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the quantities of `to_numpy` as a table over time [s].

        Raises:
            InputError: pandas is not installed.

        Example:
            >>> result.to_pandas()["handle.position"].plot()  # doctest: +SKIP
        """
        with self.log() as log:
            return log.to_pandas()

    def to_xarray(self) -> "xarray.Dataset":
        """Return the quantities of `to_numpy` as a dataset over `time` [s], each with its unit as an attribute.

        Raises:
            InputError: xarray is not installed.

        Example:
            >>> result.to_xarray()["handle.interaction"].cumsum("time").max()  # doctest: +SKIP
        """
        with self.log() as log:
            return log.to_xarray()

    def plot(
        self, *others: "SimulationResult", panels: Sequence[str] = (), width: float | str | None = None
    ) -> "Figure":
        """Return a figure of position, torque and energy over time; `others` are drawn over it in dashed lines.

        Args:
            others: Further runs.
            panels: Panels to draw, among path, position, velocity, torque, energy, surplus and motion; by default
                those that are not zero.
            width: Width of the figure [m], or a text with a unit ("88 mm"), for a paper.

        Raises:
            InputError: matplotlib is not installed, the run has no such panel, or ended before its first cycle.

        Example:
            >>> guarded.plot(unprotected, panels=["torque"], width="88 mm").savefig("both.pdf")  # doctest: +SKIP
        """
        from canhaptic.view.run_picture import energy_figure

        _require_runs(others, SimulationResult)
        with ExitStack() as stack:
            log, *further = [stack.enter_context(run.log()) for run in (self, *others)]
            figure: Figure = energy_figure(
                log, others=further, labels=[_label(run.scene) for run in others], panels=panels, width=width
            )
        return figure

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the energy log (HDF5) of the run, for `canhaptic inspect` and `EnergyLog.open`; return its path.

        Args:
            path: File to write.
            overwrite: Whether a file that exists is replaced.

        Raises:
            InputError: The file exists and `overwrite` is false, or it cannot be written.

        Example:
            >>> result.save("stiff.h5")  # doctest: +SKIP
        """
        target = Path(path)
        try:
            with target.open("wb" if overwrite else "xb") as file, self._path.open("rb") as log:
                shutil.copyfileobj(log, file)
        except FileExistsError:
            text = f"{target}: exists; choose another name, or replace it with save(..., overwrite=True)"
            raise InputError(text) from None
        except OSError as error:
            raise InputError(f"{target}: the log cannot be saved ({error.strerror}); choose another name") from error
        return target

    def __repr__(self) -> str:
        cycles = self.account.raw["cycles"]
        return f"<SimulationResult {self.scene.source}: {self.status}, {cycles} cycles, passive {self.account.verdict}>"

    def _repr_html_(self) -> str:
        """Return the verdict, the energies and the picture for a notebook."""
        from canhaptic.view.table import Cell, Table

        rows: list[list[Cell]] = [
            [name, port.verdict, port.energy_in, port.energy_out, port.dissipated, port.certificate]
            for name, port in self.account.items()
        ]
        table = Table("", ("", "passive", "in [J]", "out [J]", "dissipated [J]", "certificate"), rows)
        return f"<p><b>{html.escape(self.status)}</b></p>{table.html()}{self._embedded_picture()}"

    def _embedded_picture(self) -> str:
        try:
            figure = self.plot()
        except InputError:  # no matplotlib, or nothing to draw: the table is shown alone
            return ""
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png")
        return f'<img alt="run" src="data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}">'


def simulate(
    scene: str | PathLike[str] | Mapping[str, object] | Scene,
    changes: Mapping[str, object] | None = None,
    *,
    duration: float | str | None = None,
    progress: bool = True,
    check: bool = True,
    allow_code: bool = False,
    no_torque: bool = False,
) -> SimulationResult:
    """Simulate a scene on the virtual bus, as fast as this machine allows, and return the result.

    Args:
        scene: A scene file, a mapping with its keys, or a loaded scene.
        changes: Values of the scene to replace, by path: {"environment.stiffness": "500 N/m"}; an environment, hand,
            algorithm or effect may be a class, an instance or a function of your own, and `simulation.user.motion` an
            array or a frame of shape (n, 2) of times [s] and positions [m or rad]. Not for a loaded scene.
        duration: Length of the run [s], or a text with a unit; by default the scene's.
        progress: Whether a progress bar is shown in a terminal or a notebook.
        allow_code: Whether program files that the scene names (`type: my_wall.py:MyWall`) may run.
        no_torque: Whether the torque sent is always 0: a dry run, whose requests are in the log.
        check: Whether the error of a run that ends early is raised; otherwise it is `error` of the result.

    Raises:
        SceneError: The scene is invalid; the error lists every fault.
        InputError: The scene has no simulation, a change is not a plain value, or neither the scene nor the call gives
            a duration.
        RigError: The run ended early, and `check` is true.

    Example:
        >>> result = canhaptic.simulate("configs/demo.yaml", {"environment.damping": 0.0})  # doctest: +SKIP
        >>> result.account["handle"].passive  # doctest: +SKIP
        'yes'
    """
    loaded = load_any(scene, changes or {}, allow_code)
    if not loaded.simulated:
        text = f"{loaded.source}: got a scene without `simulation` or with a real bus, expected `simulation` and"
        raise InputError(f"{text} `bus.interface: virtual`; start a real rig by `canhaptic run`")
    length = loaded.run.duration if duration is None else RunParameters.validated({"duration": duration}).duration
    if length is None:
        text = f"{loaded.source}: duration: missing"
        raise InputError(f"{text}; add it to the scene or call simulate(..., duration=10.0)")
    cycles = max(1, round(length / loaded.bus.sample_time))
    loaded = loaded if no_torque else with_checked_holds(loaded)
    folder = Path(tempfile.mkdtemp(prefix="canhaptic-"))
    try:
        with build(loaded, "free", folder / _LOG_NAME, None, no_torque=no_torque) as experiment, (
            run_progress(cycles, loaded.bus.sample_time, "free") if progress else nullcontext()
        ) as shown_progress:  # fmt: skip
            raw, error = experiment.run_through(cycles, progress=shown_progress)
        if error is not None and check:
            raise error
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return SimulationResult(loaded, raw, error, folder)


def with_checked_holds(scene: Scene) -> Scene:
    """Return the scene with the holds that `check_hold: each_start` has confirmed, tested now.

    Raises:
        StartError: A torque acts in another hold than declared.
    """
    if all(axis.parameters.check_hold is None for axis in scene.axes):
        return scene
    from canhaptic.commission.torque_tests import checked_holds

    return checked_holds(scene, partial(print, file=sys.stderr), lambda: False)


def _imported(library: str) -> Any:
    """Import a library that only a table needs.

    Raises:
        InputError: The library is not installed.
    """
    try:
        return importlib.import_module(library)
    except ImportError as error:
        raise InputError(f"to_{library}() needs {library}; install it with: pip install {library}") from error


def _label(scene: Scene) -> str:
    return ", ".join(scene.overrides) or Path(scene.source).name


def load_any(
    scene: str | PathLike[str] | Mapping[str, object] | Scene, changes: Mapping[str, object], allow_code: bool
) -> Scene:
    """Return the scene of a file or mapping, with changes, or a loaded scene as it is; see `simulate`."""
    overrides = [_override(path, value) for path, value in changes.items()]
    if isinstance(scene, Scene):
        if changes:
            text = "changes: a loaded scene takes none"
            raise InputError(f"{text}; give them to load_scene, or name the file of the scene here")
        return scene
    if isinstance(scene, Mapping):
        return scene_from_mapping(scene, overrides=overrides, allow_code=allow_code)
    return load_scene(Path(scene), overrides, allow_code=allow_code)


def _override(path: str, value: object) -> str:
    if not isinstance(value, str | int | float):
        from canhaptic.scene.given import plain

        try:
            value = plain(value, tuple(path.split(".")))
        except TypeError as error:
            expected = "expected a number, a text, a list, a mapping, or a class, an instance or a function of your own"
            raise InputError(f"changes: {path}: got {shown(value)}, {expected} ({error})") from error
    return f"{path}={json.dumps(value)}"


def _port_account(name: str, raw: "RunResult | Inspection") -> PortAccount:
    port, truth = raw["ports"][name], raw["truth"].get(name)
    whole = cast("dict[str, Any]", raw["ports"][port.get("group", name)])
    account = {each.name: whole[each.name] for each in fields(PortAccount) if each.name in whole}
    word, by_account = whole["verdict"], whole.get("passive_at_handle", whole["passive"])
    account |= {
        "passive": word if word in WORST_LAST else by_account,
        "passive_at_motor": whole["passive"],
        "certificates": {each: RESTS_ON.get(each, ()) for each in whole.get("certificates", ())},
        "dissipated": nan if whole["dissipated"] is None else whole["dissipated"],
        "name": name,
        "energy_in": port["in"],
        "energy_out": port["out"],
        "margin": whole["margin"]["value"],
        "true_least_interaction": nan if truth is None else truth["least_interaction"],
        "group": port.get("group", ""),
        "mass_felt": port["mass"]["felt"] if "mass" in port else None,
    }
    return PortAccount(**account)

"""A scene of one CAN bus, turned into the same scene on a simulated EtherCAT line."""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from canhaptic.cycle import run
from canhaptic.drive.cycle_parameters import CycleParameters
from canhaptic.drive.profile.torque_axis_parameters import TorqueAxisParameters
from canhaptic.scene.build import Experiment
from canhaptic.units import Unit

ESI: Final = Path(__file__).resolve().parents[1] / "eds" / "ethercat_servo.xml"
_WATCHDOG: Final = 0.01  # [s], or so many sample times
_PERIODS_WATCHED: Final = 10


def on_both(values: Mapping[str, Any], effects: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Returns a scene of several axes whose last drive stays on a CAN bus, and the others are on a line."""
    found = on_ethercat(values, effects)
    found["bus"] = [{**found["bus"], "name": "line"}, {"name": "can", "interface": "virtual"}]
    *_, last = values["axes"]
    found["axes"] = [*({**axis, "bus": "line"} for axis in found["axes"][:-1]), {**last, "bus": "can"}]
    return found


def on_ethercat(values: Mapping[str, Any], effects: Mapping[str, Any] | None = None, **line: Any) -> dict[str, Any]:
    """Returns a scene with its drives on a line, in the order of their axes.

    Args:
        values: A simulated scene of one CAN bus with synchronous RPDOs.
        effects: Faults of the line; None: none, and every clock is the host's.
        **line: Further keys of the line.
    """
    found: dict[str, Any] = copy.deepcopy(dict(values))
    bus = {key: value for key, value in found["bus"].items() if key in CycleParameters.model_fields}
    period = 1.0 / float(str(Unit("Hz", "Hz").read(bus["rate"])))
    watchdog = f"{max(_WATCHDOG, _PERIODS_WATCHED * period):.6g} s"
    found["bus"] = {**bus, "type": "ethercat", "watchdog": watchdog, **line}
    found["axes"] = [
        {key: value for key, value in axis.items() if key in TorqueAxisParameters.model_fields or key == "passivity"}
        | {"position": place, "esi": str(ESI)}
        for place, axis in enumerate(found["axes"])
    ]
    found["simulation"].pop("bus", None)
    if effects:
        found["simulation"]["bus"] = dict(effects)
    return found


def torques_of(experiment: Experiment, cycles: int) -> list[tuple[float, ...]]:
    """Runs an experiment without closing it, and returns the torques that were written in each cycle [N or N*m]."""
    torques, rig = list[tuple[float, ...]](), experiment.rig
    write = rig.write_torques

    def noted(given: Any) -> None:
        torques.append(tuple(given))
        write(given)

    setattr(rig, "write_torques", noted)  # noqa: B010
    run(experiment.cycle, cycles)
    return torques


def true_energies(experiment: Experiment) -> list[float]:
    """Returns the energies of the plants of a simulated experiment [J]."""
    far: Any = experiment.far_side
    return [energy for drive in far.drives for energy in drive.truth().energy]

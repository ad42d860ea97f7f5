"""Account of a completed experiment: the energies of each port, and method and cost of the computation."""

from canhaptic.control.verdict import PortResult
from canhaptic.result import RunResult, run_result
from canhaptic.scene.build import Experiment
from canhaptic.scene.models import AxisScene


def experiment_account(experiment: Experiment, status: str, elapsed: float) -> RunResult:
    """Return what `canhaptic run --json` prints; energies in [J], times in [s].

    Args:
        experiment: The experiment after its run, completed or not.
        status: "completed", "stopped" or the reason of a stop.
        elapsed: Duration of the run [s].
    """
    scene, cycle = experiment.scene, experiment.cycle
    account = run_result(
        cycle,
        [(axis.parameters.name, axis.parameters.unit) for axis in scene.axes],
        status=status,
        config_hash=scene.config_hash(),
        sample_time=scene.bus.sample_time,
        method=_method(experiment),
    )
    names = [axis.parameters.name for axis in scene.axes if axis.simulation is not None]  # with a plant of its own
    for axis in scene.axes:
        port = account["ports"][axis.parameters.name]
        if port.get("verdict") == "nothing rendered":
            _advise(axis, port)
    account["plants"] = {
        name: {"events": plant.events, "products": plant.products}
        for name, plant in zip(names, experiment.plants, strict=False)
    }
    # In lock-step virtual time does not pass within a cycle: its durations say nothing.
    durations = account["timing"] if experiment.pace == "real" else {}
    account["timing"] = {
        "pace": experiment.pace,
        "cycles_per_second": cycle.cycles / elapsed if elapsed else 0.0,
        **durations,
        **{f"realtime_{name}": answer for name, answer in experiment.rig.realtime.report.items()},
    }
    totals = {name: bus.totals() for name, bus in experiment.faulty_buses.items()}
    if totals:
        account["bus_effects"] = totals.get("", totals)  # the only bus may have no name
    account["logs"] = {"dropped": sum(log.dropped for log in (experiment.energy_log, experiment.bus_log) if log)}
    return account


def _method(experiment: Experiment) -> str:
    """Return how the far side was computed, with its price; empty with real drives, which load nothing of it."""
    scene, plants, cycles = experiment.scene, experiment.plants, experiment.cycle.cycles
    if not scene.simulated:
        return ""
    from canhaptic.scene.method import method_line, plant_prices

    return method_line(scene, plants, cycles, plant_prices(scene, plants, cycles))


def _advise(axis: AxisScene, port: PortResult) -> None:
    """Add what keeps a wall away that was not felt."""
    from canhaptic.scene.first_contact import advice, can_be_tried

    if can_be_tried(axis):
        port["advice"] = advice(axis)

"""A run loads what its scene names, and nothing else: whole runs, each in a fresh process."""

import shutil
from pathlib import Path
from typing import Final

import pytest

from tests.acceptance.two_processes import Listener, canhaptic, shared_bus  # noqa: F401 - a fixture
from tools.count_structure import code_of, loaded_modules

ROOT: Final = Path(__file__).resolve().parents[2]
CODE_OF_A_REAL_AXIS: Final = 12_400
"""Most lines of code that one real axis may load, on a bus that is not SocketCAN and without its preflight (170)."""
CODE_OF_THE_DEMO: Final = 12_950
"""Most lines of code that the demo may load, its simulation in `canhaptic/sim/` left out.

Both are what was reached on 29 November 2026, with no module of another bus, of groups or of a far side: a fifth reads
and checks the scene, a fifth checks and starts the drive, a seventh is `guarded` with its certificates.
"""
KINDS: Final[dict[str, tuple[str, ...]]] = {
    "simulation": (
        *("sim.drive", "sim.bus", "sim.plant.plant", "sim.plant.user", "control.energy_audit"),
        *("scene.method", "scene.far_side"),
    ),
    "effect": ("sim.plant.effects.",),
    "approximate effect": ("sim.plant.splitting",),
    "group": ("control.multi_axis.", "control.port_hamiltonian.", "scene.group_layout"),
    "kinematics": ("control.mechanisms.",),
    "mechanism": ("sim.plant.mechanism.",),
    "display": (
        *("control.admittance.", "drive.can.motion_", "drive.profile.motion_"),
        *("scene.displays", "sim.drive.profile.motion_", "sim.plant.velocity_drive"),
    ),
    "device at the axis": ("canopen.attached_devices",),
    "force node": ("sim.drive.can.sensor_node",),
    "impedance algorithm": ("control.passivity.guarded", "control.certificates.certified_torque"),
    "own code": ("scene.own_code",),
    "log": ("logs.bus_", "logs.columns", "logs.energy_", "logs.ring", "logs.writer", "scene.scene_logs"),
    "fault of the bus": ("sim.bus.faulty_bus",),
    "drive profile": ("scene.profiles",),
    "fault of the drive": ("canopen.code_texts",),
    "every figure": ("view.energy_table", "view.table"),
    "fault of the scene": ("scene.explain", "scene.first_contact"),
    "override": ("scene.overrides",),
    "checked by its motion": ("control.motion_checks",),
    "SDO in the cycle": ("drive.can.background_sdo",),
    "SocketCAN": ("host.socketcan_state",),
    "compiled": ("kernels.compiler", "kernels.linking"),
    "cause of a tremor": ("audit.why",),
    "other command": (
        *("audit.inspection", "audit.listened", "audit.re", "audit.two_logs", "audit.user_checks"),
        *("commission", "lab", "replay"),
    ),
}
"""What a scene may name -> beginnings of the modules that only such a scene loads; a dot at the end: not the table."""
GUARDED: Final = frozenset({"simulation", "impedance algorithm"})
WALL: Final = """
from typing import Annotated
from canhaptic.extending import Environment, quantity


class Spring(Environment):
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0)] = 200.0

    def effort(self, state: float) -> float:
        return self.stiffness * state
"""


def kinds_of(modules: list[str]) -> set[str]:
    names = [name.removeprefix("canhaptic.") for name in modules]
    return {kind for kind, starts in KINDS.items() if any(name.startswith(starts) for name in names)}


def loaded(scene: str, *options: str) -> set[str]:
    modules = loaded_modules(ROOT, *options, scene=scene, duration=0.02)
    assert {"canhaptic.cycle", "canhaptic.drive.rig", "canhaptic.scene.build"} <= set(modules)
    return kinds_of(modules)


@pytest.mark.slow
def test_a_bare_simulated_axis_loads_its_algorithm_and_its_plant_alone() -> None:
    assert loaded("configs/demo.yaml") == GUARDED


@pytest.mark.slow
def test_the_demo_loads_no_more_code_than_can_be_read() -> None:
    own = [name for name in loaded_modules(ROOT, duration=0.02) if not name.startswith("canhaptic.sim")]
    assert code_of(ROOT, own) <= CODE_OF_THE_DEMO


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "kinds"),
    [
        ("configs/hard/sim_stop_1khz.yaml", {"simulation", "effect"}),
        ("configs/hard/sim_lugre_presliding.yaml", {"simulation", "effect", "approximate effect"}),
        ("configs/two_handles.yaml", {"simulation", "impedance algorithm", "group", "kinematics", "fault of the bus"}),
        ("configs/five_bar_sphere.yaml", {"simulation", "impedance algorithm", "group", "kinematics", "mechanism"}),
        ("configs/admittance/virtual_mass.yaml", {"simulation", "display", "effect", "checked by its motion"}),
        (
            "configs/admittance/force_node.yaml",
            {"simulation", "display", "effect", "checked by its motion", "device at the axis", "force node"},
        ),
    ],
)
def test_a_scene_loads_what_it_names(scene: str, kinds: set[str]) -> None:
    assert loaded(scene) == kinds


@pytest.mark.slow
def test_own_code_alone_loads_what_reads_it(tmp_path: Path) -> None:
    text = (ROOT / "configs" / "demo.yaml").read_text().replace("type: spring_damper_wall", "type: my_wall.py:Spring")
    (tmp_path / "scene.yaml").write_text(text.replace("  position: -0.05 m\n", ""))
    (tmp_path / "my_wall.py").write_text(WALL)
    shutil.copy(ROOT / "eds" / "cia402_servo.eds", tmp_path)
    assert loaded(str(tmp_path / "scene.yaml"), "--allow-code") == GUARDED | {
        "own code",
        "log",
    }  # memory of the kind that a log shares


@pytest.mark.slow
def test_what_is_asked_for_is_loaded(tmp_path: Path) -> None:
    """Without this, a kind whose modules have other names today would be absent everywhere."""
    found = loaded(
        *("configs/demo.yaml", "--log", str(tmp_path / "run.h5"), "--set", "passivity.device_friction=0.1 N"),
        *("--set", "simulation.effects=[{type: coulomb_friction, static: 0.3, kinetic: 0.2}]"),
    )
    assert found == GUARDED | {"log", "override", "checked by its motion", "effect", "cause of a tremor"}
    for kind, starts in KINDS.items():
        for start in starts:
            path = start.rstrip(".").replace(".", "/")
            assert any((ROOT / "canhaptic").glob(f"{path}*")), (kind, start)


@pytest.mark.slow
def test_a_real_axis_loads_no_simulation_and_no_more_code_than_can_be_read(
    shared_bus: tuple[Listener, list[str]],  # noqa: F811
) -> None:
    listener, words = shared_bus
    verified = ["torque_verified=balance", "position_reference=absolute"]
    declared = ["sync_jitter=5 %", "torque_window=100 us", "current_lag=500 us", "device_friction_bound=2 N"]
    words_of_master = [word for key in declared for word in ("--set", f"passivity.{key}")]
    words_of_master += [word for key in verified for word in ("--set", f"axes.0.{key}")]
    with canhaptic("drive", str(ROOT / "configs/demo.yaml"), *words) as drive:
        assert drive.stderr is not None
        listener.wait_for(lambda frame: frame.can_id == 0x701)
        modules = loaded_modules(ROOT, *words, "--set", "simulation=null", *words_of_master, duration=0.3)
    assert kinds_of(modules) == {"impedance algorithm", "override"}
    assert [name for name in modules if name.startswith("canhaptic.sim.")] == [
        *("canhaptic.sim.plant", "canhaptic.sim.plant.effects", "canhaptic.sim.plant.mechanism"),
    ]  # a parameter model and two tables
    own = [name for name in modules if not name.startswith(("canhaptic.sim", "canhaptic.scene.overrides"))]
    assert code_of(ROOT, own) <= CODE_OF_A_REAL_AXIS

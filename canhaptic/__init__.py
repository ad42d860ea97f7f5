"""canhaptic: passive haptic rendering on industrial CiA 402 servo drives over CAN.

    import canhaptic

    result = canhaptic.simulate("configs/demo.yaml", {"environment.stiffness": "500 N/m"})
    print(result.account["handle"].margin)

Names are imported when they are first used, so that `import canhaptic` costs nothing.
"""

import importlib
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from canhaptic.control.balance import EnergyBalance as EnergyBalance
    from canhaptic.control.balance import Ledger as Ledger
    from canhaptic.control.passivity import build_controller as build_controller
    from canhaptic.control.passivity.controller import LoopProperties as LoopProperties
    from canhaptic.cycle import Cycle as Cycle
    from canhaptic.cycle import run as run
    from canhaptic.drive.rig import Rig as Rig
    from canhaptic.errors import CanHapticError as CanHapticError
    from canhaptic.logs.energy_reader import EnergyLog as EnergyLog
    from canhaptic.result import run_result as run_result
    from canhaptic.scene.build import build as build
    from canhaptic.scene.load import load_scene as load_scene
    from canhaptic.sim.plant.direct_rig import DirectRig as DirectRig
    from canhaptic.sim.plant.plant import Plant as Plant
    from canhaptic.simulation import SimulationResult as SimulationResult
    from canhaptic.simulation import simulate as simulate

_PUBLIC: Final = {
    "CanHapticError": "canhaptic.errors",
    "Cycle": "canhaptic.cycle",
    "DirectRig": "canhaptic.sim.plant.direct_rig",
    "EnergyBalance": "canhaptic.control.balance",
    "EnergyLog": "canhaptic.logs.energy_reader",
    "Ledger": "canhaptic.control.balance",
    "LoopProperties": "canhaptic.control.passivity.controller",
    "Plant": "canhaptic.sim.plant.plant",
    "Rig": "canhaptic.drive.rig",
    "SimulationResult": "canhaptic.simulation",
    "build": "canhaptic.scene.build",
    "build_controller": "canhaptic.control.passivity",
    "load_scene": "canhaptic.scene.load",
    "run": "canhaptic.cycle",
    "run_result": "canhaptic.result",
    "simulate": "canhaptic.simulation",
}

__all__ = list(_PUBLIC)


def __dir__() -> list[str]:
    """Returns the public names."""
    return sorted(__all__)


def __getattr__(name: str) -> Any:
    """Imports a public name on its first use (PEP 562)."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'canhaptic' has no attribute {name!r}")
    return getattr(importlib.import_module(_PUBLIC[name]), name)

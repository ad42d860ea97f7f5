"""canhaptic: passive haptic rendering on industrial CiA 402 servo drives over CAN.

    import canhaptic

    result = canhaptic.simulate("configs/demo.yaml", {"environment.stiffness": "500 N/m"})
    print(result.account["handle"].margin)

Names are imported when they are first used, so that `import canhaptic` costs nothing.
"""

import importlib
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from canhaptic import errors as errors
    from canhaptic import extending as extending
    from canhaptic.audit.recompute import recompute as recompute
    from canhaptic.control.balance import Branch as Branch
    from canhaptic.control.balance import Certificate as Certificate
    from canhaptic.control.balance import EnergyBalance as EnergyBalance
    from canhaptic.control.ledger import Ledger as Ledger
    from canhaptic.control.ledger import LedgerSummary as LedgerSummary
    from canhaptic.control.multi_axis import build_group_controller as build_group_controller
    from canhaptic.control.passivity import build_controller as build_controller
    from canhaptic.control.passivity.controller import LoopProperties as LoopProperties
    from canhaptic.cycle import Cycle as Cycle
    from canhaptic.cycle import run as run
    from canhaptic.drive.can.background_sdo import BackgroundSdo as BackgroundSdo
    from canhaptic.drive.profile.link_policy import StopReason as StopReason
    from canhaptic.drive.rig import Rig as Rig
    from canhaptic.errors import CanHapticError as CanHapticError
    from canhaptic.errors import InputError as InputError
    from canhaptic.errors import RigError as RigError
    from canhaptic.lab.batch import run_batch as run_batch
    from canhaptic.lab.from_python import accuracy as accuracy
    from canhaptic.lab.from_python import check as check
    from canhaptic.lab.from_python import compare as compare
    from canhaptic.lab.from_python import design as design
    from canhaptic.lab.from_python import sweep as sweep
    from canhaptic.program import open_rig as open_rig
    from canhaptic.replay import replay_bus_log as replay_bus_log
    from canhaptic.scene.build import Experiment as Experiment
    from canhaptic.scene.build import build as build
    from canhaptic.scene.load import load_scene as load_scene
    from canhaptic.scene.load import scene_from_mapping as scene_from_mapping
    from canhaptic.scene.load import scene_from_text as scene_from_text
    from canhaptic.scene.models import Scene as Scene
    from canhaptic.signals import PlantEnergy as PlantEnergy
    from canhaptic.signals import Sample as Sample
    from canhaptic.signals import Truth as Truth
    from canhaptic.sim.plant.direct_rig import DirectRig as DirectRig
    from canhaptic.sim.plant.plant import Plant as Plant
    from canhaptic.simulation import Account as Account
    from canhaptic.simulation import EnergyLog as EnergyLog
    from canhaptic.simulation import PortAccount as PortAccount
    from canhaptic.simulation import SimulationResult as SimulationResult
    from canhaptic.simulation import simulate as simulate

_PUBLIC: Final = {
    "Account": "canhaptic.simulation",
    "PortAccount": "canhaptic.simulation",
    "BackgroundSdo": "canhaptic.drive.can.background_sdo",
    "Branch": "canhaptic.control.balance",
    "CanHapticError": "canhaptic.errors",
    "Certificate": "canhaptic.control.balance",
    "Cycle": "canhaptic.cycle",
    "DirectRig": "canhaptic.sim.plant.direct_rig",
    "EnergyBalance": "canhaptic.control.balance",
    "EnergyLog": "canhaptic.simulation",
    "Experiment": "canhaptic.scene.build",
    "InputError": "canhaptic.errors",
    "Ledger": "canhaptic.control.ledger",
    "LedgerSummary": "canhaptic.control.ledger",
    "LoopProperties": "canhaptic.control.passivity.controller",
    "Plant": "canhaptic.sim.plant.plant",
    "PlantEnergy": "canhaptic.signals",
    "Rig": "canhaptic.drive.rig",
    "RigError": "canhaptic.errors",
    "Sample": "canhaptic.signals",
    "Scene": "canhaptic.scene.models",
    "SimulationResult": "canhaptic.simulation",
    "StopReason": "canhaptic.drive.profile.link_policy",
    "Truth": "canhaptic.signals",
    "build": "canhaptic.scene.build",
    "build_controller": "canhaptic.control.passivity",
    "build_group_controller": "canhaptic.control.multi_axis",
    "accuracy": "canhaptic.lab.from_python",
    "check": "canhaptic.lab.from_python",
    "compare": "canhaptic.lab.from_python",
    "design": "canhaptic.lab.from_python",
    "load_scene": "canhaptic.scene.load",
    "open_rig": "canhaptic.program",
    "recompute": "canhaptic.audit.recompute",
    "replay_bus_log": "canhaptic.replay",
    "run": "canhaptic.cycle",
    "run_batch": "canhaptic.lab.batch",
    "scene_from_mapping": "canhaptic.scene.load",
    "scene_from_text": "canhaptic.scene.load",
    "simulate": "canhaptic.simulation",
    "sweep": "canhaptic.lab.from_python",
}
_MODULES: Final = ("errors", "extending")

__all__ = list(_PUBLIC)


def __dir__() -> list[str]:
    """The public names, and the two modules that hold the others."""
    return sorted([*__all__, *_MODULES])


def __getattr__(name: str) -> Any:
    """Import a public name on its first use (PEP 562)."""
    if name in _MODULES:
        return importlib.import_module(f"canhaptic.{name}")
    if name not in _PUBLIC:
        raise AttributeError(f"module 'canhaptic' has no attribute {name!r}")
    return getattr(importlib.import_module(_PUBLIC[name]), name)

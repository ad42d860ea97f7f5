# The public names; `__init__.py` imports each where it is first used.

from canhaptic import errors as errors
from canhaptic import extending as extending
from canhaptic import passivity as passivity
from canhaptic.audit.recompute import recompute as recompute
from canhaptic.control.balance import Branch as Branch
from canhaptic.control.balance import Certificate as Certificate
from canhaptic.control.balance import EnergyBalance as EnergyBalance
from canhaptic.control.environments.own_environment import Environment as Environment
from canhaptic.control.ledger import Ledger as Ledger
from canhaptic.control.ledger import LedgerSummary as LedgerSummary
from canhaptic.control.multi_axis import build_group_controller as build_group_controller
from canhaptic.control.passivity import LoopProperties as LoopProperties
from canhaptic.control.passivity import build_controller as build_controller
from canhaptic.cycle import Cycle as Cycle
from canhaptic.cycle import run as run
from canhaptic.drive.can.background_sdo import BackgroundSdo as BackgroundSdo
from canhaptic.drive.rig import Rig as Rig
from canhaptic.drive.safety.link_policy import StopReason as StopReason
from canhaptic.errors import CanHapticError as CanHapticError
from canhaptic.errors import InputError as InputError
from canhaptic.errors import RigError as RigError
from canhaptic.lab.batch.marching import run_batch as run_batch
from canhaptic.lab.from_python import accuracy as accuracy
from canhaptic.lab.from_python import check as check
from canhaptic.lab.from_python import compare as compare
from canhaptic.lab.from_python import design as design
from canhaptic.lab.from_python import sweep as sweep
from canhaptic.lab.from_python import touch as touch
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
from canhaptic.world import World as World

__all__: list[str]
__version__: str

def listed(file: str) -> dict[str, str]: ...

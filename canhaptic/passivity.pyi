# The names for a loop of one's own; `passivity.py` imports each where it is first used.

from canhaptic.control.balance import Branch as Branch
from canhaptic.control.balance import Certificate as Certificate
from canhaptic.control.balance import EnergyBalance as EnergyBalance
from canhaptic.control.environments.coulomb_surface import CoulombSurface as CoulombSurface
from canhaptic.control.environments.detents import Detents as Detents
from canhaptic.control.environments.hardening_wall import HardeningWall as HardeningWall
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall as SpringDamperWall
from canhaptic.control.environments.two_sided_wall import TwoSidedWall as TwoSidedWall
from canhaptic.control.environments.viscoelastic_medium import ViscoelasticMedium as ViscoelasticMedium
from canhaptic.control.ledger import Ledger as Ledger
from canhaptic.control.ledger import LedgerSummary as LedgerSummary
from canhaptic.control.mechanisms.five_bar import FiveBar as FiveBar
from canhaptic.control.multi_axis import build_group_controller as build_group_controller
from canhaptic.control.passivity import LoopProperties as LoopProperties
from canhaptic.control.passivity import build_controller as build_controller
from canhaptic.control.passivity.guarded import GuardedParameters as GuardedParameters
from canhaptic.control.passivity.internal_dissipation import StoredModelParameters as StoredModelParameters
from canhaptic.control.port_hamiltonian.shapes.box import Box as Box
from canhaptic.control.port_hamiltonian.shapes.sphere import Sphere as Sphere
from canhaptic.control.verdict import passive_verdict as passive_verdict
from canhaptic.errors import ControlError as ControlError
from canhaptic.errors import ParameterError as ParameterError

__all__: list[str]

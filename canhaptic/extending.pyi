# The names for user-defined parts; `extending.py` imports each where it is first used.

from canhaptic.control.balance import AT_REST as AT_REST
from canhaptic.control.balance import GroupBalance as GroupBalance
from canhaptic.control.environments import ENVIRONMENTS as ENVIRONMENTS
from canhaptic.control.environments.own_environment import Environment as Environment
from canhaptic.control.environments.own_environment import OwnEnvironment as OwnEnvironment
from canhaptic.control.mechanisms import KINEMATICS as KINEMATICS
from canhaptic.control.mechanisms.kinematics import Kinematics as Kinematics
from canhaptic.control.mechanisms.kinematics import Limit as Limit
from canhaptic.control.mechanisms.kinematics import Pose as Pose
from canhaptic.control.mechanisms.kinematics import UserFunction as UserFunction
from canhaptic.control.multi_axis import NETWORKS as NETWORKS
from canhaptic.control.multi_axis.group_controller import GroupController as GroupController
from canhaptic.control.multi_axis.group_controller import NetworkEnvironment as NetworkEnvironment
from canhaptic.control.passivity import ALGORITHMS as ALGORITHMS
from canhaptic.control.passivity import Controller as Controller
from canhaptic.control.passivity.stepped import SteppedController as SteppedController
from canhaptic.kernels import Kernel as Kernel
from canhaptic.sim.plant.assembly import NonlinearForce as NonlinearForce
from canhaptic.sim.plant.assembly import PlantModel as PlantModel
from canhaptic.sim.plant.effects import EFFECTS as EFFECTS
from canhaptic.sim.plant.effects import Effect as Effect
from canhaptic.sim.plant.user import OwnHand as OwnHand
from canhaptic.units import Parameters as Parameters
from canhaptic.units import quantity as quantity

__all__: list[str]

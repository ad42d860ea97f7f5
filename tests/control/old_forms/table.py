"""The sampled algorithms as they were before they shared a step: what the shared ones must equal to the last bit."""

from typing import Final

from tests.control.old_forms.a_priori_dissipation import APrioriDissipation
from tests.control.old_forms.adaptive_reference import AdaptiveReference
from tests.control.old_forms.bounded_observer import BoundedObserver
from tests.control.old_forms.display_controller import DisplayController
from tests.control.old_forms.dissipating_display import DissipatingDisplay
from tests.control.old_forms.energy_bounding import EnergyBounding
from tests.control.old_forms.energy_tank import EnergyTank
from tests.control.old_forms.force_augmentation import ForceAugmentation
from tests.control.old_forms.force_gradient import ForceGradient
from tests.control.old_forms.internal_dissipation import InternalDissipation
from tests.control.old_forms.observed_display import ObservedDisplay
from tests.control.old_forms.passivity_observer import PassivityObserver
from tests.control.old_forms.stepped import SteppedController
from tests.control.old_forms.tank_display import TankDisplay
from tests.control.old_forms.ultimate_passivity import UltimatePassivity
from tests.control.old_forms.ultimately_passive_display import UltimatelyPassiveDisplay
from tests.control.old_forms.unprotected import Unprotected
from tests.control.old_forms.unprotected_display import UnprotectedDisplay
from tests.control.old_forms.windowed_observer import WindowedObserver

OLD_FORMS: Final[dict[str, type[SteppedController]]] = {
    "unprotected": Unprotected,
    "a_priori_dissipation": APrioriDissipation,
    "internal_dissipation": InternalDissipation,
    "passivity_observer": PassivityObserver,
    "energy_bounding": EnergyBounding,
    "adaptive_reference": AdaptiveReference,
    "windowed_observer": WindowedObserver,
    "bounded_observer": BoundedObserver,
    "force_gradient": ForceGradient,
    "force_augmentation": ForceAugmentation,
    "energy_tank": EnergyTank,
    "ultimate_passivity": UltimatePassivity,
}
"""Name in a scene -> the class as it was."""

OLD_DISPLAYS: Final[dict[str, type[DisplayController]]] = {
    "unprotected": UnprotectedDisplay,
    "internal_dissipation": DissipatingDisplay,
    "passivity_observer": ObservedDisplay,
    "energy_tank": TankDisplay,
    "ultimately_passive": UltimatelyPassiveDisplay,
}
"""The same of admittance displays."""

"""A viscoelastic medium: a spring that gives way with time (Maxwell), with a damper in parallel (Jeffreys)."""

import math
from typing import Annotated, ClassVar

from canhaptic.control.environments import LinearSpring
from canhaptic.units import quantity


class ViscoelasticMedium(LinearSpring):
    """Dough: stiff against fast motion, yielding to slow motion; it remembers for about its relaxation time."""

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e9)]
    """Stiffness of the spring that relaxes."""
    relaxation_time: Annotated[float, quantity("s", gt=0.0)]
    """Time in which an undisturbed spring relaxes to 1/e: series damping over stiffness."""

    relaxes: ClassVar[bool] = True

    def relaxed(self, state: float, sample_time: float) -> float:
        """Return x exp(-T / relaxation time): exact for a hold without motion."""
        return state * math.exp(-sample_time / self.relaxation_time)

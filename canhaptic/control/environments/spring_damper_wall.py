"""The paper's virtual wall: a spring and a damper in parallel, felt on one side of a plane (eqs. 12-14)."""

from canhaptic.control.environments import LinearSpring, OneSided


class SpringDamperWall(OneSided, LinearSpring):
    """A wall that is in contact while the position is beyond its surface."""

"""Tables in which user-defined environments, algorithms, effects, hands, kinematics and networks are registered.

Such a part is a class with the methods of its protocol. Scenes can use it once a table names it::

    from canhaptic.extending import ENVIRONMENTS

    ENVIRONMENTS["centering_spring"] = "centering_spring:CenteringSpring"

Examples are in docs/extending.md. `extending.pyi` lists the names; each is imported when it is first used.
"""

from canhaptic import door

__all__, __dir__, __getattr__ = door(__file__, __name__)

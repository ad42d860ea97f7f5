"""Passivity algorithms for a loop of your own: no CAN, no file, no thread; pydantic is the only dependency.

A controller takes the position at a sample and the torque held until then; it returns the next torque, and the energies
of the hold that ended. See "A loop of your own" in docs/from_python.md. `passivity.pyi` lists the names; each is
imported when it is first used.
"""

from canhaptic import door

__all__, __dir__, __getattr__ = door(__file__, __name__)

"""Virtual environments of one axis, each in its own file, and the table of their names."""

from typing import Final

_HERE: Final = "canhaptic.control.environments"

ENVIRONMENTS: Final[dict[str, str]] = {
    "spring_damper_wall": f"{_HERE}.spring_damper_wall:SpringDamperWall",
    "two_sided_wall": f"{_HERE}.two_sided_wall:TwoSidedWall",
    "hardening_wall": f"{_HERE}.hardening_wall:HardeningWall",
    "detents": f"{_HERE}.detents:Detents",
    "viscous_medium": f"{_HERE}.viscous_medium:ViscousMedium",
    "viscoelastic_medium": f"{_HERE}.viscoelastic_medium:ViscoelasticMedium",
    "coulomb_surface": f"{_HERE}.coulomb_surface:CoulombSurface",
    "damper_wall": f"{_HERE}.damper_wall:DamperWall",
    "free_space": f"{_HERE}.free_space:FreeSpace",
}
"""Name in a scene -> "module:Class"; the class is the parameter model and the environment in one."""

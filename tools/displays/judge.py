"""What the plant denies of the account of an admittance display."""

from typing import Protocol

from canhaptic.control.verdict import PASSIVE_TOLERANCE
from tools.displays.direct import Display, Outcome

ROUNDING = 1e-9  # [J]


class Judged(Protocol):
    """Energies of a run [J]."""

    overclaimed: float
    underclaimed: float
    least: float
    uncertified: int


def false_claims(display: Display, found: Outcome) -> list[str]:
    """Returns what the account says and the plant's energy at the sensor denies; the declarations being true."""
    claims = claims_of(found, display.allowance, promises=display.algorithm == "guarded")
    if found.is_passive and found.least < -PASSIVE_TOLERANCE:
        claims.append(f"passive by the account, {found.least:.3g} J by the plant")
    return claims


def claims_of(found: Judged, allowance: float, *, promises: bool) -> list[str]:
    """Returns the claims that the energy denies of one display, or of a group with one account.

    Args:
        found: Energies of the run.
        allowance: Energy that may be given out [J].
        promises: Whether the algorithm certifies its commands.
    """
    claims = []
    if found.overclaimed > ROUNDING:
        claims.append(f"the account is {found.overclaimed:.3g} J above the energy that came in")
    if found.underclaimed > ROUNDING:
        claims.append(f"account and resolution are {found.underclaimed:.3g} J below the energy that came in")
    if promises and not found.uncertified and found.least < -allowance - ROUNDING:
        claims.append(f"certified to {-allowance:.3g} J, {found.least:.3g} J by the plant")
    return claims

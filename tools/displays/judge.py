"""What the plant denies of the account of an admittance display."""

from canhaptic.control.verdict import PASSIVE_TOLERANCE
from tools.displays.direct import Display, Outcome

ROUNDING = 1e-9  # [J]


def false_claims(display: Display, found: Outcome) -> list[str]:
    """Returns what the account says and the plant's energy at the sensor denies; the declarations being true."""
    claims = []
    if found.overclaimed > ROUNDING:
        claims.append(f"the account is {found.overclaimed:.3g} J above the energy that came in")
    if found.underclaimed > ROUNDING:
        claims.append(f"account and resolution are {found.underclaimed:.3g} J below the energy that came in")
    if found.is_passive and found.least < -PASSIVE_TOLERANCE:
        claims.append(f"passive by the account, {found.least:.3g} J by the plant")
    if display.algorithm == "guarded" and not found.uncertified and found.least < -display.allowance - ROUNDING:
        claims.append(f"certified to {-display.allowance:.3g} J, {found.least:.3g} J by the plant")
    return claims

"""Division of one hold's energy between store and surplus, as `guarded` does it for one axis and for a group."""


def settle(
    h_s: float, surplus: float, lost: float, ceiling: float, slack: float
) -> tuple[float, float, float, float, float, float]:
    """Return (h_s, surplus, h_r, deficit, leak, paid) after a hold [J].

    Args:
        h_s: Stored energy including the hold's; below 0 is a deficit.
        surplus: Energy still to be dissipated.
        lost: Energy that the dissipators of the model took; below 0 counts as 0.
        ceiling: Energy that the model stores at its true state; more is not kept.
        slack: Part of `h_s` that the certificates of the torques under way do not need; the rest may not be given up.
    """
    h_r = deficit = leak = paid = 0.0
    if lost > 0.0 and slack > 0.0:
        h_r = lost if lost < slack else slack
        h_s -= h_r
        slack -= h_r
    if h_s < 0.0:
        deficit, h_s = -h_s, 0.0
        surplus += deficit
    elif h_s > ceiling:
        paying = surplus if surplus > 0.0 else 0.0
        above, allowed = h_s - ceiling, paying + slack if slack > 0.0 else paying
        if above <= allowed:
            leak, h_s = above, ceiling
        else:
            leak = allowed
            h_s -= leak
        paid = leak if leak < paying else paying
        surplus -= paid
    return h_s, surplus, h_r, deficit, leak, paid

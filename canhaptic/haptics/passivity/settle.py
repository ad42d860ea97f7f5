"""Closing the account of one hold: whatever the algorithm did, every joule gets a name."""

from canhaptic.haptics.balance import EnergyBalance


def close_account(
    *,
    torque: float,
    h_i: float,
    h_pas: float,
    h_r: float,
    h_s: float,
    h_dis_before: float,
    gen: float,
    deficit: float,
    leak: float,
    branch: int,
    damping_rendered: float,
    certificate: int,
    state: float,
) -> EnergyBalance:
    """Returns the balance of one hold with the surplus brought forward: leaks pay surplus first."""
    surplus = h_dis_before + gen + deficit - h_pas
    paid = min(leak, surplus) if leak > 0.0 and surplus > 0.0 else 0.0
    return EnergyBalance(
        torque,
        h_i,
        h_pas,
        h_i - h_pas,
        h_r,
        h_s,
        surplus - paid,
        gen,
        deficit,
        leak,
        paid,
        branch,
        damping_rendered,
        certificate,
        state,
    )

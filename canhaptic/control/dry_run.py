"""The account of a dry run, in which no torque was sent: a positive result proves nothing about the controller."""

from canhaptic.control.balance import Certificate
from canhaptic.control.verdict import PortResult


def claim_nothing(account: PortResult) -> None:
    """Remove from a port's account what needs a sent torque: certificates and rendered shares.

    Args:
        account: Account of the port; changed.
    """
    account["dry_run"] = True
    account["certificate"], account["certificates"] = Certificate.NONE.name.lower(), []
    account["damping_rendered"] = {"least": 0.0, "most": 0.0}
    if "contact" in account:
        contact = account["contact"]
        contact["without_torque"] = contact["holds"]
        if "sent" in contact:
            contact["sent"] = 0.0
    if "rendered" in account:
        for share in ("stiffness", "damping"):
            if account["rendered"][share] is not None:
                account["rendered"][share] = 0.0

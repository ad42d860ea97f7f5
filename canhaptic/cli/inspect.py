"""`canhaptic inspect LOG`: the account of a finished run, checked, compared, drawn, exported, recomputed."""

from canhaptic.view.inspect_command import add_arguments, execute

__all__ = ["add_arguments", "execute"]

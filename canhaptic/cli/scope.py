"""`canhaptic scope LOG`: a live page on a log as it is written."""

from canhaptic.view.scope_command import add_arguments, execute

__all__ = ["add_arguments", "execute"]

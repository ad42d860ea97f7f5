"""`canhaptic replay BUSLOG --config CONFIG`: a recorded bus against today's master, every frame compared."""

from canhaptic.view.replay_command import add_arguments, execute

__all__ = ["add_arguments", "execute"]

"""`canhaptic decode BUSLOG`: every frame of a bus log, named."""

from canhaptic.view.decode_command import add_arguments, execute

__all__ = ["add_arguments", "execute"]

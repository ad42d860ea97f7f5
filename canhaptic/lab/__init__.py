"""The laboratory: comparison, judgement and pictures.

The rest of the package only names it, in tables of commands, algorithms and choices, and does not import it.
"""

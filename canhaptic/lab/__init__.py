"""The laboratory: comparison, judgement and pictures.

The product names it in its tables of commands, algorithms and choices, and imports none of it.
"""

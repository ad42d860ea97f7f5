"""The laboratory: what compares, judges and draws.

The product names it in its tables of commands, algorithms and choices, and imports none of it.
"""

"""Maps of a sweep: how stiff a wall may be over rate, damping and whatever else was varied, and what is left of it.

field    the figures of a sweep by the values of its keys      border   the largest stiffness that passes, and theory
panel    what is drawn, as plain values                        panels          which of them
picture, page   PNG and HTML of the same panels
"""

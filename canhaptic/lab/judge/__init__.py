"""Independent reference plant in textbook form, which checks the simulated plant.

It shares only the parameters of a scene and the columns of a motion with `canhaptic.sim.plant.plant`. Its equations are
written separately (functions of time instead of oscillators, forces instead of matrix rows), and so are its mode
transitions. It is solved with event location or with fixed steps.
"""

"""An independent reference plant in textbook form, to check the simulated plant: event-located or fixed-step methods.

Shares with `canhaptic.sim.plant.plant` only the parameters of a scene and the columns of a motion. The equations are
written again (time instead of oscillators, forces instead of rows, no matrices), and so are the mode transitions.
"""

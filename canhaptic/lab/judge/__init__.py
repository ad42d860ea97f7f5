"""An independent reference plant in textbook form, which judges the first: event-located or fixed-step methods.

Shares with `canhaptic.sim.plant.plant` only the parameters of a scene and the columns of a motion. The equations are
written again (time instead of oscillators, forces instead of rows, no matrices), and so are the ways from mode to mode.
"""

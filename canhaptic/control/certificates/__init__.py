"""Upper bounds on the torque of the next hold, each with its proof."""

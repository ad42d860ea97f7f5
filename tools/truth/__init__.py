"""The account of random scenes against the energy of the simulated plant: draw, judge, shrink."""

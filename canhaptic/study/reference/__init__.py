"""The continuous environment rendered to the same user and plant: the ideal that sampled algorithms are compared with."""

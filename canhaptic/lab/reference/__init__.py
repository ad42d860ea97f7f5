"""The continuous environment rendered to the same user and plant: the ideal for comparison."""

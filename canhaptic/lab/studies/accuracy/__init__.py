"""The cost of accuracy in time: every method to compute and render a scene, with its errors and its cost."""

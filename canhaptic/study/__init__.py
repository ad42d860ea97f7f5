"""Studies: algorithms side by side on one scene, judged by the simulated plant and by the continuous environment."""

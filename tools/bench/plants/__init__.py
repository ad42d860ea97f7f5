"""Scenes, peers and references of the benchmark of plants (`tools/bench/simulation.py`)."""

"""Sweeps: vary any keys of a scene on a grid or a Latin hypercube, on one core, a process pool or a cluster.

vary          parses `--vary` and numbers the scenes
chunk         makes scenes from values and computes their figures
run_sweep     sends chunks of scenes to workers, and results to the store
sweep_table   reads, writes and summarises the results
"""

from canhaptic.lab.studies.sweep.run_sweep import sweep

__all__ = ["sweep"]

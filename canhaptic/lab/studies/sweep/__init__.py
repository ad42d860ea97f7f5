"""Sweeps: vary any keys of a scene on a grid or a Latin hypercube, on one core, a process pool or a cluster.

vary          parses `--vary` and numbers the scenes
chunk         makes scenes from values and computes their figures
run_sweep     sends chunks of scenes to workers, and results to the store
first_use     runs scenes in Python while their loop is being compiled
sweep_table   reads and writes the results
summary       tables of a finished or running sweep
"""

from canhaptic.lab.studies.sweep.run_sweep import sweep

__all__ = ["sweep"]

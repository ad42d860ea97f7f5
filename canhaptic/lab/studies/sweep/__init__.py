"""Sweeps: any keys of a scene, on a grid or a Latin hypercube, on one core, a process pool or a cluster.

vary          parser of `--vary`, and the scenes by global index
chunk         where a varied key is in a scene; from values to scenes, and to their figures
run_sweep     chunks to workers and to the store          first_use    Python runs scenes while their loop is compiled
sweep_table   the results                                 summary      their meaning in words
"""

from canhaptic.lab.studies.sweep.run_sweep import sweep

__all__ = ["sweep"]

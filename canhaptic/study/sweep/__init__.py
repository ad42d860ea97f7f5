"""Sweeps: any keys of a scene, on a grid or a Latin hypercube, on one core, a process pool or a cluster.

points   which scenes there are, by global index            vary     what `--vary` says
recipe   a row of values to a scene, or why it is refused   chunk    the figures of consecutive scenes
table    the file: fixed layout, one flag per chunk         workers  where chunks run
sweep    chunks to workers, results to the table            summary  what a file holds, in words
"""

from canhaptic.study.sweep.run_sweep import sweep

__all__ = ["sweep"]

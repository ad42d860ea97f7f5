"""Sweeps: any keys of a scene, on a grid or a Latin hypercube, on one core, a process pool or a cluster.

vary          parser of `--vary`                places        where a varied key is in a scene
points        the scenes, by global index       recipe        a row of values to a scene, or why it is refused
chunk         the figures of some scenes        workers       where chunks run
run_sweep     chunks to workers and to a file   chunk_files   chunks that are not in the file yet
sweep_table   the file, its layout              selected      shares and medians of a file
summary       contents of a file, in words
"""

from canhaptic.lab.studies.sweep.run_sweep import sweep

__all__ = ["sweep"]

"""Simulate many scenes in one call: the engine of a sweep, compiled where numba is installed, else interpreted.

    reason = why_not_batchable(scene)            # "" or the reason by name
    run_batch(scene, {"environment.stiffness": k, "bus.rate": rates}, cycles=1000, engine="auto")
    run_scalar(scene, cycles=1000)               # the same figures of one scene, with any plant

**One source.** The controller's kernels (`canhaptic.kernels`), the plant and the sums of the figures run in one loop
(`closed_loop`). The same source runs in Python and as machine code, with equal bits; only sine and exponential may
differ in their last bit, because they come from the C library. A linear plant moves by its transition matrix over a
hold, a plant with events by the stepper of `canhaptic.sim.plant` (both in `plants`). Scenes are computed one after the
other and are independent.

Compiling takes some 10 s, once for each algorithm and environment; the machine code is stored on disk (`compiler`).
"""

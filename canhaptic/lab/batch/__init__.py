"""Many scenes at once: the engine of a sweep, compiled where numba is installed and interpreted otherwise.

    reason = why_not_batchable(scene)            # "" or the reason by name
    run_batch(scene, {"environment.stiffness": k, "bus.rate": rates}, cycles=1000, engine="auto")
    run_scalar(scene, cycles=1000)               # the same names, one scene, any plant

**One source.** The kernels of a controller (`canhaptic.kernels`), the plant and the sums of the figures run in one loop
(`closed_loop`): in machine code, or in Python with the same bits (but for the functions of the C library, sine and
exponential, whose last bit depends on its library). A linear plant moves by its flow over a hold (`plants`), one with
events by the stepper of `canhaptic.sim.plant` (`event_plant`). Scenes are computed one after the other, and none
depends on another.

Compiling takes some 10 s once for each algorithm and environment; the machine code is kept (`compiler`).
"""

"""The sampled loop without a bus, or over it: one case of a scene, run and recorded."""

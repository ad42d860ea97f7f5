"""The simulated bus: frames, wire time and faults."""

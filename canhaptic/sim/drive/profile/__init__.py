"""CiA 402 of the simulated drive: objects, state machine, power stage. Knows no frames."""

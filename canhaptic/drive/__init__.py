"""The master's side of the bus: bring-up, cyclic exchange, stop."""

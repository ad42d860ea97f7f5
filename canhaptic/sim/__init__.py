"""The far side of the bus: drive, motor and user, simulated."""

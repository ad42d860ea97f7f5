"""The simulated side of the bus: drive, motor and user."""

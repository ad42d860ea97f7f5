"""Studies of admittance displays (force in, velocity out): their loop without a bus, its figures, design, accuracy."""

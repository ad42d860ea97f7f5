"""Certificates: upper bounds on the torque of the next hold, each with a proof that no energy is generated."""

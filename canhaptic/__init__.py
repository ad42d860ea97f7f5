"""canhaptic: passive haptic rendering on industrial CiA 402 servo drives over CAN."""

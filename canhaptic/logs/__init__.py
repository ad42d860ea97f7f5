"""Energy log and bus log: written in the cycle, read afterwards."""

"""Replays the drive's side of a recorded bus against the real master and controllers."""

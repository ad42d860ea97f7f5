"""Runs of one axis or group, without a bus or over CAN, with a record of every SYNC."""

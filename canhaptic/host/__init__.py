"""Interfaces to this computer: SocketCAN, python-can back ends, real-time settings, output files."""

"""This computer: SocketCAN interfaces, python-can back ends, real-time settings."""

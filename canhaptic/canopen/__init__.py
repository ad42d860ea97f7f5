"""CANopen facts without bus I/O: reader of EDS and DCF files, object indices, bits, and texts of codes."""

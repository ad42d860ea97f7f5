"""CANopen as data: the reader of EDS and DCF files, object indices and bits, and words for codes. No I/O on a bus."""

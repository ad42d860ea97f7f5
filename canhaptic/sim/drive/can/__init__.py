"""CANopen of the simulated drive: NMT, SDO server, PDOs, EMCY, process data at SYNC."""

"""The simulated drive: an independent CiA 402 node with SDO server, PDOs and watchdogs."""

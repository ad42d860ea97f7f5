"""The profile over CAN: frames, COB-IDs, SDO and PDO, bus budget."""

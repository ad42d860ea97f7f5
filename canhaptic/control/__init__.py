"""Host mathematics: displacement to energy balance to torque. No bus, no clock, no files."""

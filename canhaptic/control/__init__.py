"""Controllers and energy accounts: from measured motion to torque. Uses no bus, clock or file."""

"""Studies with many runs: compare, accuracy, sweep, map, design, arena."""

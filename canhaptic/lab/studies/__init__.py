"""Many runs of one question: compare, accuracy, sweep, map, design, arena."""

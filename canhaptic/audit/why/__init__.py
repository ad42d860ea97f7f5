"""Why does it buzz: what trembles in a log (`ripple`), and by which causes (`causes`), each tested on the log."""

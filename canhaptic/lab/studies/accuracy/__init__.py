"""What accuracy costs in time: every way to compute a scene and to render it, each with its errors and its price."""

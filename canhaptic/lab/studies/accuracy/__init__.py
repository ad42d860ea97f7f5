"""The computing time that accuracy costs: methods to compute and render a scene, with their errors and costs."""

"""Scene files: YAML to validated models to a built rig."""

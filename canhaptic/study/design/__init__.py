"""The stiffest and most damped wall that a rig renders: `trial` judges walls, `wall` searches, `report` says it."""

"""The stiffest and most damped wall that a rig renders.

`trial` judges walls, `wall` searches, `design_report` shows the result.
"""

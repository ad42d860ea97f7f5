"""The stiffest and most damped wall that a rig renders, and the lightest mass of an admittance display.

`trial` judges walls, `search` searches walls and masses, `contact_quality` tells what a hand feels at a wall.
"""

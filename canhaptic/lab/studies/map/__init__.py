"""Maps of a sweep: how stiff a wall may be over rate, damping and every other varied key, and what is left of it.

field     the figures of a sweep by the values of its keys
z_width   the largest stiffness that passes; theory   what closed forms permit
headline  all algorithms in one panel
panels    what is drawn; panel   its plain values
map_picture, map_page   PNG and HTML of the same panels
"""

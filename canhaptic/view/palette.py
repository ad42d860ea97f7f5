"""Colours of every picture and page: those of Okabe and Ito, which colour-blind readers distinguish, and two greys.

Lines differ in width and style too.
"""

BLUE, VERMILION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
PURPLE, SKY = "#CC79A7", "#56B4E9"
GREY, PALE = "#4D4D4D", "#8C8C8C"
OVERLAID = ("black", PURPLE, SKY, PALE)
"""Colours of further runs in one picture, in turn."""

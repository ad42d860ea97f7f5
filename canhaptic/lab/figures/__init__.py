"""Figures of a run: energy, figures of the literature, and the contact felt by the hand."""

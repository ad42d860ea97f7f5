"""Figures of a run: of its energy, its field and what a hand feels."""

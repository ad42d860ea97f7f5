"""Admittance displays without a bus: random ones, and what the plant says of their accounts."""

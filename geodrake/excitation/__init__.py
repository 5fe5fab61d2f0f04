"""Excitation: which motion tells a robot's parameters best, and what a given one can tell."""

"""Efforts as formulas: recorded with symbols, and evaluated with numbers of other types."""

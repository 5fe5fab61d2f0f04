"""Fleets of robots: what a type shares, how each robot differs, and what changed since when."""

"""Robots on their feet that hide something, and what `geodrake explain` says of them."""

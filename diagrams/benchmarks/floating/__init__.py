"""Robots on their feet by MuJoCo, with something hidden, and what `geodrake explain` says of them."""

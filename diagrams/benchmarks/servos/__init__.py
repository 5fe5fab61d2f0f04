"""Servos of known gains behind simulated arms, and what is said of them."""

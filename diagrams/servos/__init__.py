"""Servos of known gains behind arms, simulated by Pinocchio and by MuJoCo, and what is said of them."""

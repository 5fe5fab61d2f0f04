"""Fits whose speed `identification_speed.py` measures, and the same program in CVXPY."""

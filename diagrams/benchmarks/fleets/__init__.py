"""Simulated fleets whose robots change, by formulas of their own, and what is found in them."""

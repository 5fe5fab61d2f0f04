"""Simulated robots with hidden effects: engines, motions, effects, logs, and scores.

Engines are Pinocchio and MuJoCo; no formula is taken from geodrake.
"""

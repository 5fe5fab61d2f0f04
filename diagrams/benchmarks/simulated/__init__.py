"""Simulated robots that hide something: engines, motions, effects, logs, and how to score.

Engines are Pinocchio and MuJoCo, and no formula is geodrake's.
"""

"""Exports verified in simulators: their content, missing effects, and loss of accuracy."""

from geodrake.control.export_proof.export import export_to

__all__ = ["export_to"]

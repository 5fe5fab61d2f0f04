"""Exports tried in simulators: what they hold, what they lack, and what that costs."""

from geodrake.control.export_proof.export import ProvenExport, export_to

__all__ = ["ProvenExport", "export_to"]

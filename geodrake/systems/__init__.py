"""Drake systems: thin LeafSystems over geodrake's functions, one a file."""

from __future__ import annotations

from geodrake.systems.effect_force import EffectForce
from geodrake.systems.effort_delay import DelayedEffort
from geodrake.systems.tracking import add_tracking_drives

__all__ = ["DelayedEffort", "EffectForce", "add_tracking_drives"]

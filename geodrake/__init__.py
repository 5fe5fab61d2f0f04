"""geodrake: what a robot's model is missing, found in its measurements, and then fixed."""

from geodrake.saved_model import load_model, save_model

__all__ = ["load_model", "save_model"]

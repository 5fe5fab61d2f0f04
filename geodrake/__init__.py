"""geodrake: what a robot's model is missing, found in its measurements, and then fixed."""

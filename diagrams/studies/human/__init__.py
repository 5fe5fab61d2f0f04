"""A human on a force plate: the measurements, and figures of what was identified."""

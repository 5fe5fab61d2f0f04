"""The studies of adaptive control in parts: robots, laws, closed loops, gains, figures."""

"""The studies of excitation in parts: robots, motions, expected errors, figures."""

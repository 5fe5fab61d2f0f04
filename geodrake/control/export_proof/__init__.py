"""Exports tried in simulators: what they hold, what they lack, and what that costs."""

"""Logs of robots with hidden effects, made by other engines than geodrake's, and how to score."""

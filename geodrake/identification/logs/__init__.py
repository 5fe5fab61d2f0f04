"""Fits from logs: triangular factors of every block, hypotheses on them, and `compare`."""

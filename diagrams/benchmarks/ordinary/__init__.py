"""Ordinary robots: arms with friction, rotors and tools, and what a diagnosis says of them."""

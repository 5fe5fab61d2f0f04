"""Drake systems: thin LeafSystems over geodrake's functions, one per file."""

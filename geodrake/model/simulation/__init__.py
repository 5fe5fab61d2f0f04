"""A model in a Drake diagram: its effects as LeafSystems, and all of it in one call."""

"""A model's effort as a function without dependencies, in Python or C++, for a controller.

What a model computes is run once with symbols in the place of numbers (`symbols`), which gives
formulas (`effort_formula`, `rigid_bodies`); these become a straight line of statements
(`straight_line`) in a language (`languages`).
"""

from geodrake.model.source.files import cpp_source, python_source, source_files

__all__ = ["cpp_source", "python_source", "source_files"]

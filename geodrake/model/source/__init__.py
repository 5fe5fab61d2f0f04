"""A model's effort as a function without dependencies, in Python or C++, for a controller.

What a model computes is run once with symbols in the place of numbers (`symbols`), which gives
formulas (`effort_formula`, `rigid_bodies`); these become a straight line of statements
(`straight_line`) in a language (`languages`).
"""

from geodrake.model.source.effort_formula import is_written
from geodrake.model.source.files import EffortSource, cpp_source, effort_source, python_source

__all__ = ["EffortSource", "cpp_source", "effort_source", "is_written", "python_source"]

"""Text of a model file, simplified before Drake parses it.

Drake refuses some files that describe a robot well enough for its dynamics (a mesh that is not
there, a mimic joint that mimics nothing), and silently puts a 1 kg ball in the place of an inertia
it finds impossible. So geometry and loop closures are taken out of the text first, and inertias
that no body can have are set aside (`ModelText.set_aside`), for `geodrake.robot.plant` to repair.
"""

from geodrake.robot.files.description import ModelDescription, read_description
from geodrake.robot.files.given import Given

__all__ = ["Given", "ModelDescription", "read_description"]

"""Parts of the study of motions that tell effects apart: a simulated robot, its hidden effects."""

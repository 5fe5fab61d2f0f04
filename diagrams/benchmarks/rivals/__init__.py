"""Parts of the study of motions that distinguish effects: a simulated robot, its hidden effects."""

"""The AMBIDEX study in parts: the arm, its measurements, the fits of one draw, figures."""

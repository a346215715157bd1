"""What the colours of the view mean."""

from __future__ import annotations

Colour = tuple[float, float, float]  # red, green, blue, 0 to 1

BACKGROUND: Colour = (0.075, 0.09, 0.12)
GOLD: Colour = (1.0, 0.70, 0.12)  # true
CYAN: Colour = (0.10, 0.80, 0.90)  # estimated
ICE: Colour = (0.88, 0.94, 1.0)  # measured
ORANGE: Colour = (1.0, 0.42, 0.05)  # imputed
GREY: Colour = (0.45, 0.47, 0.50)  # lost
WHITE: Colour = (1.0, 1.0, 1.0)  # principal
PALE: Colour = (0.62, 0.72, 0.95)  # reference
GREEN: Colour = (0.15, 0.85, 0.25)  # origin
VIOLET: Colour = (0.42, 0.40, 0.75)  # where the hips went
COLOURS = (GOLD, CYAN, ICE, ORANGE, GREY, WHITE, PALE, GREEN, VIOLET)

"""Paints appearances: grounds, balls, clutter, and what camera and sensor do to the picture."""

"""Painting of appearances: ground, balls, clutter, effects of camera and sensor."""

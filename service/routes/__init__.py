"""Routes, one module a feature. What they need stands in the app's state."""

"""Settings, precision and distributed processes; imports nothing else of the package."""

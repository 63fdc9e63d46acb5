"""Server processes: start, stop, connections, Ray Serve."""

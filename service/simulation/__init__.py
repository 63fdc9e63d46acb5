"""Scene simulation in worker processes."""

"""Training data: splits, shards of simulations, scene cache, windows, clips."""

"""Rollcast forecasts rolling balls; this is what training, service and clients share."""

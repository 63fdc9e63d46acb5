"""Forecasts of rolling balls: code shared by training, service and clients."""

"""Rollcast: forecasts of rolling balls - the vocabulary that training, service and clients share."""

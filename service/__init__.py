"""Forecasts over HTTP: registry, runtime, rollout and routes. Independent of torch."""

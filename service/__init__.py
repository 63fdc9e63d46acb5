"""The forecasts over HTTP: registry, runtime, rollout and routes. It knows nothing of torch."""

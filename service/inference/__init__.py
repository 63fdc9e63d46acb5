"""Computing forecasts: ONNX Runtime, rollout, scheduling, deadlines."""

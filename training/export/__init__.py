"""Artefacts for the service: ONNX graphs, manifest, golden values, model card."""

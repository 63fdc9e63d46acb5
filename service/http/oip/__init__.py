"""The Open Inference Protocol (``/v2``): its schemas and tensors."""

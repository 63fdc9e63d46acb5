"""Which model answers: artefact loading, registry, forecast warnings."""

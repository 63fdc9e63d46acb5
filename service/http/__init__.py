"""HTTP layer: request bodies, problem documents, routes, headers."""

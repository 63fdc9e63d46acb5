"""Everything that knows HTTP: request bodies, problem documents, routes, headers."""

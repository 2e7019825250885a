"""What other packages may add: renderers, objectives, and backends, found by their entry points."""

"""Plugins: renderers, objectives and measurement backends of other distributions."""

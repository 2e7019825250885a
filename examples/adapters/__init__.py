"""Adapters of other people's renderers, to copy from."""

"""Proxy scenes, which have gradients where the scene itself has none."""

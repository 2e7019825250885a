"""Proxy scenes: substitutes with gradients for the parts of a scene without gradients."""

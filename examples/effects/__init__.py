"""Twelve small scenes that need different effects of light transport, and the gain of planning them."""

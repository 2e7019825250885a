"""Twelve small scenes that call for different effects of light transport, and what planning them is worth."""

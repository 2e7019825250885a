"""Helpers shared by the experiments."""

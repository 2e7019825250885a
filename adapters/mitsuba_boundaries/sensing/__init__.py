"""Sensors and films, with their adjoints."""

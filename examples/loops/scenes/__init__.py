"""Scenes of the loops, each made by the library that renders it."""

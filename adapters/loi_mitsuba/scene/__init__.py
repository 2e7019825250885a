"""Scenes of Mitsuba: loading, checks, named parameters and poses."""

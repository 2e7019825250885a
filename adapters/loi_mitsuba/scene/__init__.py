"""Mitsuba scenes: loading, checks, named parameters and poses."""

"""Attached samples, which move with lights and with clear glass."""

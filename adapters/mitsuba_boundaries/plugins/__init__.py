"""Plugins of Mitsuba for proxy scenes."""

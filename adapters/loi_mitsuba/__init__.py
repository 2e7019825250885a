"""The mitsuba adapter of loi."""

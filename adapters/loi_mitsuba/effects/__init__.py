"""Which effects of light transport a Mitsuba scene calls for: traits, sound rules, a pilot, and its upkeep in a fit."""

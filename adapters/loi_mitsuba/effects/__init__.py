"""Plan the effects of light transport that a Mitsuba scene needs: traits, rules, a pilot, and updates during a fit."""

"""The loops of the README as whole programs: something finds a place that it does not overlap at first."""

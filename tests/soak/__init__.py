"""Long runs, shortened."""

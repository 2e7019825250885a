"""Scene files: what they hold, how they are read, and the experiment that they describe."""

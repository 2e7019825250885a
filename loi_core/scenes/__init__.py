"""Scene files: their content, how they are read, and the experiment that they describe."""

"""The paper's one-dimensional figures and its first figure."""

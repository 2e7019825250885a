"""The jax adapter of loi."""

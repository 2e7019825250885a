"""Thirty scenes that nobody tuned, fitted from far with every default: ``python -m examples.convergence``."""

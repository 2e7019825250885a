"""Attached sampling: samples that move with the scene."""

"""Photographs with their cameras, as COLMAP and NeRF's tools write them."""

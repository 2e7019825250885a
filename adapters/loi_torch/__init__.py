"""The torch adapter of loi."""

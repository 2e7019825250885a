"""Small helpers without images: arrays of any library, charts, the wording of messages, caches, checks."""

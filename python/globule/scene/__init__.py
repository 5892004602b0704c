"""Particles, their octree, the field that they make, and questions about it."""

"""Fluids, tissue and the knife: simulations whose octree is also traced."""

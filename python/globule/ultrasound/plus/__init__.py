"""PLUS's volume reconstruction, voxel by voxel the same."""

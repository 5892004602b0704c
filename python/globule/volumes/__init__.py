"""Volumes of voxels: their files, slices and iso-surfaces."""

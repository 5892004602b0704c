"""Measured from the field: samples, gauges, meshes, volumes and areas, projections."""

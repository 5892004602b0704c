"""Picture files: environments, OpenEXR, movies."""

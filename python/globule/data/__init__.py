"""What users have: particles with attributes and triangles, and what their places alone tell."""

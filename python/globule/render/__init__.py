"""From a scene to an image: cameras, light, materials, clips, layers, sequences."""

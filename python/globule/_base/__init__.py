"""Parts that every room uses: arrays, devices, checks, files."""

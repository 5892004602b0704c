"""What every room uses: arrays, devices, checks, files."""

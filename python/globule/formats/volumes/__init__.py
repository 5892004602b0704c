"""Volume files, one module per format; `globule.volume_io` chooses."""

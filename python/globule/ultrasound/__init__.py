"""From a tracked sweep to a volume, live or from files; calibration; trust."""

"""The embedded data set of `globule demo`."""

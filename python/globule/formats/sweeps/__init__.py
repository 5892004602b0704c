"""Tracked sweeps: files, poses and regions; `globule.sweep` puts them together."""

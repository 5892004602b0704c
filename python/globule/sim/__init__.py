"""The parts of a simulation: tissue, blades."""

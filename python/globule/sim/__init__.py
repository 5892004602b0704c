"""The parts of a simulation: emitters, tissue, blades."""

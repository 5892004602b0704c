"""What surrounds the solver of `globule.Simulation`: scenes, instruments, tissue, diagnostics."""

"""What surrounds the solver of `globule.Simulation`: scenes, shapes, instruments, diagnostics."""

"""Parts of a simulation: what enters and leaves it."""

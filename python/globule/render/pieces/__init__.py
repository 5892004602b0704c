"""Images of scenes in pieces, and of scenes on the ranks of MPI."""

"""Planning with path constraints: errors, projection, proofs, search, smoothing, timing."""

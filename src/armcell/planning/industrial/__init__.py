"""Industrial motions: PTP, LIN, CIRC and sequences of them with blend radii; MoveIt's Pilz pipeline."""

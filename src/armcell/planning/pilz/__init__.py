"""Industrial motions PTP, LIN, CIRC and blended sequences, like MoveIt's Pilz pipeline."""

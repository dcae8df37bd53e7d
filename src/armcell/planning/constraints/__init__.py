"""Constraints on joints, positions, orientations and views.

Evaluation, planning on the manifold, proofs.
"""

"""Franka Control Interface on the wire: messages, errors and limits."""

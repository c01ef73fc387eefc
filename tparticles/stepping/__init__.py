"""Interpreters of schemes, and the choice of steps."""

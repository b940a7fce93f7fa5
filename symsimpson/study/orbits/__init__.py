"""Periodic orbits, boundary values, families of orbits and their stability."""

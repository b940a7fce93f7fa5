"""Expressions as a directed acyclic graph without duplicate nodes."""

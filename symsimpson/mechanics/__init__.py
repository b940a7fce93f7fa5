"""Mechanical systems: what a user declares, and what is known of it before any discretisation."""

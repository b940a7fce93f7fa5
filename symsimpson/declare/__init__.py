"""Mechanical systems: what a user declares, and what is known of it before any discretisation."""

import symsimpson.declare.retimed  # noqa: F401  # systems can be retimed from the beginning

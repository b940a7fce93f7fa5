"""Robots: trees of links and joints, their readers, and the systems that they declare."""

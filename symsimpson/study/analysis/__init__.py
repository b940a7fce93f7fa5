"""Measurements on runs: certificates, orders, stability, choices of a scheme and a step."""

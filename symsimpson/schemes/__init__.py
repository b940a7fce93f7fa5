"""Schemes as tables of numbers, from a quadrature and a polynomial basis."""

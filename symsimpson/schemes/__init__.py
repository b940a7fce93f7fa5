"""Schemes as data: a quadrature, a basis and the tables that follow from them."""

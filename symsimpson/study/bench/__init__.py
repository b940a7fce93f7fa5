"""Measurements: they print, they never decide a test."""

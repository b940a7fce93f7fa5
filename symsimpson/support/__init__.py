"""Helpers that know nothing of mechanics: messages, files, bars, names; anybody may import them."""

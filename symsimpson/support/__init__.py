"""Helpers without mechanics: names, messages, files, progress bars. Every room may import them."""

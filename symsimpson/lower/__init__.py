"""From discrete equations to the text of a self-contained module."""

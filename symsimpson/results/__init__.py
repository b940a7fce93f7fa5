"""Results: states, what follows from them, and files."""

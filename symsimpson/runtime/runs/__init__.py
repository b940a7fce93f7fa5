"""One run: how it begins, goes on, is kept on disk, and what its energy tells of it."""

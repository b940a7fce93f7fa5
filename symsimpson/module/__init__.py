"""The contract of generated modules: their blocks of rows, their definitions, their arithmetic."""

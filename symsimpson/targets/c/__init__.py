"""Steps in other languages: a module and its driver as one file of C."""

"""Ensembles: many runs at once, on SIMD lanes, threads and clusters, in memory or in a store."""

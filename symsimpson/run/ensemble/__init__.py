"""Many runs at once, on lanes, threads and clusters, and in stores."""

"""Many runs at once: on threads, on clusters, in stores."""

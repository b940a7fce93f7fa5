"""The compiled loop over steps: one text, walked once for a machine."""

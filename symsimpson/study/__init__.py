"""Studies of systems and steppers: certificates, optimal control, comparisons."""

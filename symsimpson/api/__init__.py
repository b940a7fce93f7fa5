"""The public face: making steppers, and steppers, of which each method hands on to the runtime."""

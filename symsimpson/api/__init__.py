"""The public face: making steppers, and steppers, whose methods hand on to other folders."""

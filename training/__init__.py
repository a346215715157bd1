"""From captures to one model file, and how good it is."""

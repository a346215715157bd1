"""A device that is not there: clip or synthetic performer, corrupted, paced, as real bytes."""

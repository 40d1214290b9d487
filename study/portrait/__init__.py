"""A portrait of an environment: statistics and pictures that say what it is like."""

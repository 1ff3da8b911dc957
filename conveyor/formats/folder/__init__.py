"""The plain folder recording."""

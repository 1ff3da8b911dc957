"""Which view goes to which regressor, and tracks that wait for their weights."""

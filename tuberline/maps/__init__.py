"""A field's map from runs and positions: what is read, how it is drawn."""

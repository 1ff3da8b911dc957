"""Our MCAP recordings."""

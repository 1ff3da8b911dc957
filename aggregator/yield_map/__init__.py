"""From tubers with times and a machine's positions to a map of the field: t/ha with counts and intervals."""

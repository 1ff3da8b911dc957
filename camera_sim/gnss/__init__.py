"""The machine's GNSS receiver as a node: its positions onto the line and into positions.csv of the run."""

"""From Zenoh to Rerun: a separate process that shows a line, blocks nothing and costs nothing when no one looks."""

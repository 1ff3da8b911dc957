"""Pictures of a line in Rerun: scenes make primitives, sinks carry them to a file or a live hub."""

"""Foxglove: primitives as its own schemas, into an MCAP file or to its app over a WebSocket."""

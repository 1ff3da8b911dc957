"""What all of Tuberline's processes share: topics, messages, the Zenoh session, node life cycle, config."""

__version__ = "0.2.0.dev0"

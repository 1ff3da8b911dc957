"""What all of Tuberline's processes share: topics, messages, the Zenoh session, node life cycle, config."""

__version__ = "0.1.0"

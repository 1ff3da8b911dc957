"""From what is plugged in or lies here to a line's file: what `tuberline init` finds and writes."""

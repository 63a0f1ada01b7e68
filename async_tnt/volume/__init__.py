"""The incremental volume: its configuration, the decoding of events, and the cells of a window."""

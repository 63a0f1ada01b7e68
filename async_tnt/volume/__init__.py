"""The incremental volume: its configuration, packets of events decoded and checked, the cells of a
window."""

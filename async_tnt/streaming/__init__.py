"""From events to decisions: which windows are open, when a decision is due, and what is decided."""

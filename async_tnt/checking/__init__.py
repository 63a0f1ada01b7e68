"""Stream against batch: the promise of equality on one's own recordings, and what either costs."""

"""Measurements, comparisons and figures of the project's pages; run from a checkout, not part of the wheel."""

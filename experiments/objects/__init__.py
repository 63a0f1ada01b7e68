"""Made recordings of objects in motion."""

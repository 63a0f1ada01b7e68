"""Models, their files, and the classifiers that run them."""

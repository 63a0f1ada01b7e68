"""Stream against batch: whether both agree (`async-tnt check`), and what they cost (`async-tnt bench`)."""

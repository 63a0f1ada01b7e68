"""The check that the stream agrees with the batch reference (`async-tnt check`)."""

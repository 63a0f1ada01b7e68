"""Whether the stream agrees with the batch reference (`async-tnt check`)."""

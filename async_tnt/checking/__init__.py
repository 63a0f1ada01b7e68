"""Whether the stream agrees with the batch reference (`async-tnt check`), and exported networks with ours."""

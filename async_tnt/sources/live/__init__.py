"""Events that arrive now: cameras, datagrams from the network, and their clocks."""

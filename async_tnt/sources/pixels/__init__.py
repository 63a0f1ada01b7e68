"""Which pixels count: regions, masks, and hot pixels that recordings show."""

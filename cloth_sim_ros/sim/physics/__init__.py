"""One file per concept, each a few Warp functions on values; none reads an array, none imports another."""

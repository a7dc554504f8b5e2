"""From a map to its distribution, and from that to samples."""

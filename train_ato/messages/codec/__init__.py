"""CDR encoding and decoding of every message of the topic table."""

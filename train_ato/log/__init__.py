"""Log of a run: an MCAP file in the layout of ``ros2 bag``, with its ``metadata.yaml``."""

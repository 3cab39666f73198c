"""The log of a run: an MCAP file as ``ros2 bag`` lays it out, with its ``metadata.yaml``."""

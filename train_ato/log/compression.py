"""Compression of chunks, named after the storage presets of ``ros2 bag``: ``none``, ``fast`` and ``small``.

``python studies_done/recorder.py`` measures them for a train of 106 vehicles.
"""

import argparse
from collections.abc import Callable

import zstandard

from train_ato.program.arguments import add_option

Pack = Callable[[bytes | bytearray], bytes]
"""Compression function for the content of one chunk."""

COMPRESSIONS: tuple[str, ...] = ("none", "fast", "small")
DEFAULT = "fast"
FAST = 1
"""Level of zstd, the default of the C++ writer of MCAP. LZ4 gives a log that is 13 % larger."""
SMALL = zstandard.ZstdCompressionParameters(
    window_log=17,
    chain_log=14,
    hash_log=15,
    search_log=2,
    min_match=3,
    strategy=zstandard.STRATEGY_BTOPT,
    target_length=8,
    write_content_size=1,
)
"""Similar floating-point numbers have only their first bytes in common, so short matches and their optimal choice
(``BTOPT``) pay off. Similar numbers are one or two ticks apart, so the tables are small.
"""


def packer(compression: str) -> tuple[str, Pack]:
    """Return the name of a compression in an MCAP file and its function; ValueError if there is no such choice."""
    if compression == "none":
        return "", bytes
    if compression == "fast":
        return "zstd", zstandard.ZstdCompressor(level=FAST).compress
    if compression == "small":
        return "zstd", zstandard.ZstdCompressor(compression_params=SMALL).compress
    raise ValueError(f"compression '{compression}' does not exist; choose {', '.join(COMPRESSIONS)}")


def add_compression(parser: argparse.ArgumentParser) -> None:
    """Declare the option ``--compression``."""
    add_option(
        parser,
        "--compression",
        "compression of the log; small needs many times the CPU time of fast (default: fast)",
        choices=COMPRESSIONS,
        default=DEFAULT,
    )

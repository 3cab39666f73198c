"""Messages as bytes: the dataclasses of the stack in CDR, the encoding of ROS 2, and back.

A message whose layout does not change during a run (fixed names, fixed lengths) is written by a *template*: the
bytes are made once by the Jazzy serialiser of ``rosbags``, the places of the stamp and of every float64 are found in
them and checked, and afterwards only those are filled in.  Names cost nothing that way, equal messages have equal
bytes (rclpy leaves padding uninitialised), and no ROS is needed.  A message of another publisher, valid but with
other padding or byte order, is read the long way round.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from train_ato.cdr import stamp_of
from train_ato.shape import Shape
from train_ato.topics import BY_NAME
from train_ato.wire_fixed import ArrayCodec, ReferenceCodec, ScalarCodec, array_codecs, scalar_codecs
from train_ato.wire_variable import decode_diagnostic, decode_trajectory, encode_diagnostic, encode_trajectory

__all__ = ["Shape", "Wire", "stamp_of"]


class Wire:
    """Encoder and decoder of every topic of a run.

    Parameters
    ----------
    shape
        Sizes of the train.
    """

    def __init__(self, shape: Shape) -> None:
        self.shape = shape
        codecs: list[ArrayCodec | ScalarCodec | ReferenceCodec] = [*array_codecs(shape), *scalar_codecs()]
        self._codecs = {codec.topic: codec for codec in codecs if shape.has(BY_NAME[codec.topic])}
        self._encoders: dict[str, Callable[[Any], bytes]] = {
            "ato/profile": encode_trajectory,
            "ato/limits": encode_trajectory,
            "/diagnostics": encode_diagnostic,
            **{name: codec.encode for name, codec in self._codecs.items()},
        }
        self._decoders: dict[str, Callable[[bytes], Any]] = {
            "ato/profile": decode_trajectory,
            "ato/limits": decode_trajectory,
            "/diagnostics": decode_diagnostic,
            **{name: codec.decode for name, codec in self._codecs.items()},
        }

    def encode(self, topic: str, message: Any) -> bytes:
        """Return the CDR bytes of a message.

        Raises
        ------
        ValueError
            For a field of the wrong length or type, or a value that is not finite where a law would use it.
        KeyError
            If a run of this train has no such topic.
        """
        return self._encoders[topic](message)

    def decode(self, topic: str, data: bytes) -> Any:
        """Return the message that the bytes hold; arrays are its own.

        Raises
        ------
        ValueError
            One line that names the topic and what is wrong: type, names, lengths, values that are not finite.
        KeyError
            If a run of this train has no such topic.
        """
        return self._decoders[topic](data)

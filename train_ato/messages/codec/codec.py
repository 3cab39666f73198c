"""Conversion of the dataclasses of messages to CDR bytes, the encoding of ROS 2, and back, without ROS.

Equal messages have equal bytes (rclpy leaves padding uninitialised).  Decoding accepts any padding and byte order.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from train_ato.messages.codec.cdr import stamp_of
from train_ato.messages.codec.topic_record import TopicRecord
from train_ato.messages.codec.variable import VARIABLE
from train_ato.messages.layout import TrainLayout
from train_ato.messages.topics import topics_of

__all__ = ["Wire", "stamp_of"]

MAX_FRAME = 1024
"""Maximum length of the frame and of padding, which this program leaves empty [bytes]."""
MAX_VARIABLE = 2**29
"""Maximum length of a message of variable length [bytes]."""


class Wire:
    """Encoder and decoder of every topic of a run.

    Parameters
    ----------
    layout
        Sizes of the train.

    Attributes
    ----------
    records : dict
        Records of the topics with messages of fixed length.
    """

    def __init__(self, layout: TrainLayout) -> None:
        self.layout = layout
        self._encoders: dict[str, Callable[[Any], bytes]] = {}
        self._decoders: dict[str, Callable[[bytes], Any]] = {}
        self.records: dict[str, TopicRecord] = {}
        self._decoded: dict[str, tuple[bytes, Any]] = {}
        for topic in topics_of(layout):
            if topic.of_variable_length:
                self._encoders[topic.name], self._decoders[topic.name] = VARIABLE[topic.message]
            else:
                record = self.records[topic.name] = TopicRecord(topic, layout)
                self._encoders[topic.name], self._decoders[topic.name] = record.encode, record.decode

    def longest(self, topic: str) -> int:
        """Return the maximum length of a valid message [bytes]: twice the present one, for former names."""
        return 2 * len(self.records[topic].blank) + MAX_FRAME if topic in self.records else MAX_VARIABLE

    def encode(self, topic: str, message: Any) -> bytes:
        """Return the CDR bytes of a message.

        Raises
        ------
        ValueError
            For a field of the wrong length or type, or a value that is not finite in a topic with finite values.
        KeyError
            If a run of this train has no such topic.
        """
        return self._encoders[topic](message)

    def decode(self, topic: str, data: bytes) -> Any:
        """Return the message of the bytes; arrays are copies.

        Raises
        ------
        ValueError
            One line with topic and fault: type, names, lengths, or values that are not finite.
        KeyError
            If a run of this train has no such topic.
        """
        return self._decoders[topic](data)

    def decode_shared(self, topic: str, data: bytes) -> Any:
        """Return the message of the bytes for readers that do not change it; errors as :meth:`decode`.

        Consecutive calls with equal bytes return one message, as the stages of the engine share it: three nodes read
        every measurement.
        """
        last = self._decoded.get(topic)
        if last is not None and last[0] == data:
            return last[1]
        message = self._decoders[topic](data)
        self._decoded[topic] = data, message
        return message

"""Counters of the processor: cycles and instructions of the calling thread, without those of other processes.

On a busy machine a wall time includes other processes; the least count of many short calls hardly does.  Linux only
(``perf_event_open``); a container or a virtual machine may not have the counters.
"""

from __future__ import annotations

import ctypes
import os
import platform
import struct
from collections.abc import Callable

PERF_EVENT_OPEN = {"x86_64": 298, "aarch64": 241}
"""Number of the system call by machine."""
CYCLES, INSTRUCTIONS = 0, 1
ATTRIBUTE_SIZE, FLAGS = 128, 40
USER_ONLY = 1 << 5 | 1 << 6  # exclude_kernel, exclude_hv


class ProcessorCounters:
    """Cycles and instructions of the calling thread in user mode.

    Raises
    ------
    OSError
        If the machine has no counters.
    """

    def __init__(self) -> None:
        number = PERF_EVENT_OPEN.get(platform.machine())
        if number is None or platform.system() != "Linux":
            raise OSError("no counters of the processor on this machine; use Linux on x86_64 or aarch64")
        self._files = [_open_counter(number, event) for event in (CYCLES, INSTRUCTIONS)]

    def read(self) -> tuple[int, int]:
        """Return cycles and instructions since the creation."""
        cycles, instructions = (struct.unpack("Q", os.read(file, 8))[0] for file in self._files)
        return cycles, instructions

    def least(self, call: Callable[[], object], repeats: int) -> tuple[int, int]:
        """Return cycles and instructions of the call with the fewest cycles, of several repetitions."""
        call()
        found = []
        for _ in range(repeats):
            before = self.read()
            call()
            after = self.read()
            found.append((after[0] - before[0], after[1] - before[1]))
        return min(found)


def _open_counter(number: int, event: int) -> int:
    """Return the file descriptor of a counter."""
    attribute = bytearray(ATTRIBUTE_SIZE)
    struct.pack_into("IIQ", attribute, 0, 0, ATTRIBUTE_SIZE, event)
    struct.pack_into("Q", attribute, FLAGS, USER_ONLY)
    buffer = (ctypes.c_char * ATTRIBUTE_SIZE).from_buffer(attribute)
    file: int = ctypes.CDLL(None, use_errno=True).syscall(number, buffer, 0, -1, -1, 0)
    if file < 0:
        error = ctypes.get_errno()
        raise OSError(error, f"no counters of the processor: {os.strerror(error)}; allow perf_event_open")
    return file

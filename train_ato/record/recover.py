"""Making the log of a killed run readable again."""

from __future__ import annotations

from pathlib import Path

from train_ato.record.layout import LOG, PARTIAL
from train_ato.record.reading import stream
from train_ato.record.run_log import LogFile


def recover(file: Path) -> tuple[Path, int]:
    """Read every closed chunk of a partial log and write it as a proper one with its ``metadata.yaml``.

    Parameters
    ----------
    file
        ``run.mcap.partial``, or the folder of the run.

    Returns
    -------
    path, count
        The new ``run.mcap`` and the number of messages in it; the partial file is kept as ``run.mcap.broken``.

    Raises
    ------
    ValueError
        If there is nothing to recover.
    """
    partial = file / PARTIAL if file.is_dir() else file
    if not partial.is_file():
        raise ValueError(f"{partial}: no such file; name the run.mcap.partial of a killed run")
    if partial.with_name(LOG).exists():
        raise ValueError(f"{partial.with_name(LOG)}: exists already; move it away first")
    if next(stream(partial, broken=True), None) is None:
        raise ValueError(f"{partial}: holds no whole chunk; nothing can be recovered")
    broken = partial.with_name("run.mcap.broken")
    partial.rename(broken)
    log = LogFile(partial.parent)
    numbers: dict[str, int] = {}
    count = 0
    for message in stream(broken, broken=True):
        channel, schema = message.channel, message.schema
        if channel.topic not in numbers:
            metadata = channel.metadata
            numbers[channel.topic] = log.channel(
                channel.topic,
                schema.name,
                schema.data.decode(),
                metadata.get("topic_type_hash", ""),
                metadata.get("offered_qos_profiles", "[]"),
            )
        log.write(numbers[channel.topic], message.publish_ns, message.log_ns, message.data)
        count += 1
    log.close()
    return log.path, count

"""States that page and server exchange beside the data of the figures."""

from __future__ import annotations

from bokeh.core.properties import Bool, Int
from bokeh.model import DataModel


class Beat(DataModel):  # type: ignore[misc]
    """Beat of the server, twice a second; without it the page reports the loss of its server."""

    number = Int(default=0)


class Acknowledgement(DataModel):  # type: ignore[misc]
    """Number of the event that the driver has acknowledged last."""

    number = Int(default=-1)


class Drawn(DataModel):  # type: ignore[misc]
    """Number of the newest frame drawn by the browser; ``ready`` after the figures are there."""

    number = Int(default=0)
    ready = Bool(default=False)

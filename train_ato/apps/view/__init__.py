"""Display of a running train or of a recorded run: a page in the browser and a Foxglove WebSocket.

Data (``facts``, ``snapshot``, ``guidance``, ``track_ahead``, ``messages``, ``ending``, ``protection``, ``strip``),
sources (``live``, ``recorded``) and drawing (``dial``, ``ahead``, ``strips``, ``along``, ``panel``, ``page``,
``dmi.js``, ``elevation.js``) are separate modules.  One feed serves any number of browsers.
"""

"""Display of a running train or of a recorded run: a page in the browser and a Foxglove WebSocket.

Data (``facts``, ``snapshot``, ``protection``, ``strip``), sources (``live``, ``recorded``) and drawing (``dial``,
``ahead``, ``strips``, ``along``, ``panel``, ``page``) are separate modules.  One feed serves any number of browsers.
"""

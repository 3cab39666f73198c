"""Looking at a train while it runs, or at a recorded run: one page in the browser, and a Foxglove WebSocket.

What is shown (``facts``, ``moment``, ``strip``) is apart from where it comes from (``live``, ``recorded``) and from how
it is drawn (``dial``, ``ahead``, ``strips``, ``along``, ``panel``, ``page``).  One feed serves any number of browsers.
"""

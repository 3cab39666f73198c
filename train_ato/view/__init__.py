"""Display of a running train or of a recorded run: a page in the browser, Foxglove, layouts and scene.

Data (``facts``, ``snapshot``), sources (``live``, ``recorded``) and drawing (``display``, ``panel``, ``page``,
``dmi.js``, ``elevation.js``) are separate modules. One feed serves any number of browsers.
"""

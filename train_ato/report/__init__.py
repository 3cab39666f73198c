"""Report of recorded runs: an HTML page without network access, and figures for print.

Data: ``curves``, ``delays``, ``events``, ``maps``, reduced by ``page_data`` and ``downsample``.  Drawing: ``style`` and
``panels`` return Bokeh figures of arrays, for this page and for others; ``print_figures`` uses matplotlib.
``quantities`` defines label, unit and colour of every quantity.
"""
